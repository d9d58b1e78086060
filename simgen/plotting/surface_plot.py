"""Pictures of surfaces by matplotlib alone, which needs no display and no OpenGL.

The projection is parallel. Faces that look at the viewer are drawn from far to near, others are dropped.
"""

import io
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import LinearSegmentedColormap, to_rgb
from PIL import Image

AMBIENT = 0.45
PLAIN = "#d9d4c7"
# From the gel's own pale colour to dark, so that gel at rest looks like gel and shading stays visible.
COLOURS = LinearSegmentedColormap.from_list("displacement", [PLAIN, "#f2b34c", "#d1422f", "#5c0f3c"]).with_extremes(
    bad="#a9b0b7"
)  # where there is no value


def camera(towards_viewer: np.ndarray, up: np.ndarray | None = None) -> np.ndarray:
    """View (3, 3) with rows right, up and towards the viewer: as near to ``up`` as possible, or with right near +x."""
    out = towards_viewer / np.linalg.norm(towards_viewer)
    right = np.array([1.0, 0.0, 0.0]) - out[0] * out if up is None else np.cross(up, out)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(out, right), out])


# In the shared frame the pad side is -y and the tip -x. The two views together show all of the pad.
FROM_PAD = camera(np.array([-0.45, -1.0, 0.55]))
FROM_OTHER_SIDE = camera(np.array([-0.45, -1.0, -0.55]))
LIGHT = np.array([0.11, 0.32, 0.94])  # right, up, towards the viewer


def draw_surface(
    axes: Axes,
    vertices: np.ndarray,
    triangles: np.ndarray,
    values: np.ndarray | None = None,
    *,
    largest: float = 1.0,
    view: np.ndarray = FROM_PAD,
) -> PolyCollection:
    """Draw a closed surface, m, of outward triangles. Returns the collection, for a colour bar.

    values : (vertex,) coloured from 0 to ``largest``, NaN in grey
    view : (3, 3), see `camera`
    """
    corners = vertices[triangles] @ view.T * 1e3
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), np.finfo(float).tiny)
    order = np.argsort(corners[:, :, 2].mean(axis=1))
    order = order[normal[order, 2] > 0]
    shade = AMBIENT + (1 - AMBIENT) * np.clip(normal[order] @ LIGHT, 0.0, 1.0)
    faces = PolyCollection(corners[order, :, :2], cmap=COLOURS)
    faces.set_clim(0.0, largest)
    if values is None:
        rgba = np.tile(faces.to_rgba(0.0), (len(order), 1))
        rgba[:, :3] = to_rgb(PLAIN)
    else:
        rgba = faces.to_rgba(values[triangles[order]].mean(axis=1))
    rgba[:, :3] *= shade[:, None]
    faces.set_facecolor(rgba)
    faces.set_edgecolor(rgba)  # closes the hairlines between neighbours
    faces.set_linewidth(0.3)
    axes.add_collection(faces)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_axis_off()
    return faces


def gif(frames: Sequence[np.ndarray], frame_ms: int, hold_ms: int) -> bytes:
    """Encode frames (height, width, 3 or 4) uint8 as a GIF that repeats and shows the last frame for ``hold_ms``.

    All frames use the palette of the last one. Dithering avoids edges in smooth parts.
    """
    pictures = [Image.fromarray(frame).convert("RGB") for frame in frames]
    palette = pictures[-1].quantize(256)
    first, *others = (each.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG) for each in pictures)
    data, durations = io.BytesIO(), [frame_ms] * len(others) + [hold_ms]
    first.save(data, "GIF", save_all=True, append_images=others, duration=durations, loop=0, optimize=True)
    return data.getvalue()


def draw_points(
    axes: Axes,
    points: np.ndarray,
    normals: np.ndarray,
    colours: np.ndarray,
    *,
    view: np.ndarray = FROM_PAD,
    size: float = 6.0,
) -> None:
    """Draw points (n, 3), m, on a surface whose outward normals (n, 3) look at the viewer."""
    facing = normals @ view[2] > 0
    seen = points[facing] @ view.T * 1e3
    axes.scatter(seen[:, 0], seen[:, 1], c=colours[facing], s=size, linewidths=0, zorder=3)
