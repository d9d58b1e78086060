"""Pictures of surfaces by matplotlib alone, so that they work on any machine: no display, no OpenGL.

Faces are projected in parallel, those that look away are dropped, the rest drawn from far to near.
"""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import LinearSegmentedColormap, to_rgb

FROM_PAD = np.array([-0.45, -1.0, 0.55])  # shared frame: the pad side is -y, the tip -x
LIGHT = np.array([-0.3, -0.8, 0.9])
AMBIENT = 0.45
PLAIN = "#d9d4c7"
# From the gel's own pale colour to dark: what does not move looks like gel, and the shading stays visible.
COLOURS = LinearSegmentedColormap.from_list("displacement", [PLAIN, "#f2b34c", "#d1422f", "#5c0f3c"])


def camera(towards_viewer: np.ndarray) -> np.ndarray:
    """(3, 3) rows: right, up and towards the viewer; right lies as near to +x as it can."""
    out = towards_viewer / np.linalg.norm(towards_viewer)
    right = np.array([1.0, 0.0, 0.0]) - out[0] * out
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(out, right), out])


def draw_surface(
    axes: Axes,
    vertices: np.ndarray,
    triangles: np.ndarray,
    values: np.ndarray | None = None,
    *,
    largest: float = 1.0,
    towards_viewer: np.ndarray = FROM_PAD,
) -> PolyCollection:
    """Draw a closed surface, m, outward triangles; `values` (vertex,) colour it from 0 to `largest`.

    Returns the collection, from which a colour bar can be made.
    """
    view = camera(towards_viewer)
    corners = vertices[triangles] @ view.T * 1e3
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), np.finfo(float).tiny)
    order = np.argsort(corners[:, :, 2].mean(axis=1))
    order = order[normal[order, 2] > 0]
    light = view @ LIGHT / np.linalg.norm(LIGHT)
    shade = AMBIENT + (1 - AMBIENT) * np.clip(normal[order] @ light, 0.0, 1.0)
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


def draw_points(
    axes: Axes, points: np.ndarray, colours: np.ndarray, towards_viewer=FROM_PAD, size=6.0
) -> None:
    """Draw points (n, 3), m, on top of what is there."""
    seen = points @ camera(FROM_PAD).T * 1e3
    axes.scatter(seen[:, 0], seen[:, 1], c=colours, s=size, linewidths=0, zorder=3)
