"""3D view of each sensor's surface during a press, with a slider over the depths.

plotly.js draws it. The page holds plotly.js, so nothing is loaded from the network.
"""

import html
from collections.abc import Iterator

import numpy as np
from matplotlib.colors import to_hex
from plotly.graph_objects import Figure, Frame, Mesh3d
from plotly.io import to_html
from plotly.offline import get_plotlyjs

from simgen.dataset.reader import Dataset
from simgen.plotting.html import tiles
from simgen.plotting.surface_plot import COLOURS, LIGHT, camera
from simgen.report.choice import NOTHING_YET, furthest_press, steps_axis
from simgen.report.meshes import OBLIQUE

HEIGHT_PX = 480
DISTANCE = 1.35  # of the camera, relative to the longest side
SCALE = [[step, to_hex(COLOURS(step))] for step in np.linspace(0.0, 1.0, 9).tolist()]
AT_ONCE = {"mode": "immediate", "frame": {"duration": 0, "redraw": True}, "transition": {"duration": 0}}


def solid_view_section(dataset: Dataset) -> Iterator[str]:
    press, reached = furthest_press(dataset)
    if not reached:
        yield NOTHING_YET
        return
    name = dataset.indenters[dataset["press/indenter"][press]]
    yield (
        f"<p>Press {press}, {html.escape(name)}, in each sensor's own frame. Colour: length of the displacement. Drag "
        "to rotate, pinch or scroll to zoom, and move the slider to change the depth.</p>"
        f"<script>{get_plotlyjs()}</script>"
    )
    yield tiles(_drawn_by_plotly(dataset, sensor, press, reached) for sensor in dataset.sensors)


def _drawn_by_plotly(dataset: Dataset, sensor: str, press: int, reached: int) -> str:
    drawing = to_html(
        solid_view(dataset, sensor, press, reached),
        config={"responsive": True, "displaylogo": False, "modeBarButtons": [["resetCameraDefault3d"]]},
        include_plotlyjs=False,
        full_html=False,
        default_height=f"{HEIGHT_PX}px",
        div_id=f"solid-view-{sensor}",
    )
    return f"<div><h3>{html.escape(sensor)}</h3>{drawing}</div>"


def solid_view(dataset: Dataset, sensor: str, press: int, reached: int) -> Figure:
    """Surface in mm, float32, with a frame at rest and at each depth reached. The last frame is shown."""
    points, triangles = np.unique(dataset[f"{sensor}/surface_triangles"], return_inverse=True)
    triangles = triangles.reshape(-1, 3).astype(np.int32)
    rest = dataset[f"{sensor}/rest_positions"][points]
    moved = dataset.displacement(sensor, press, slice(0, reached))[:, points]
    moved = np.concatenate([np.zeros((1, *rest.shape)), moved])
    position, length = (np.float32(1e3 * values) for values in (rest + moved, np.linalg.norm(moved, axis=-1)))
    steps, _ = steps_axis(dataset)
    labels = ["0", *(f"{step:g}" for step in steps[:reached])]
    prefix, unit = ("depth ", " mm") if dataset.indenter_path.is_a_press else ("step ", "")

    def mesh(step: int, **fixed) -> Mesh3d:
        x, y, z = np.ascontiguousarray(position[step].T)
        return Mesh3d(x=x, y=y, z=z, intensity=length[step], **fixed)

    i, j, k = np.ascontiguousarray(triangles.T)
    look = {"ambient": 0.55, "diffuse": 0.6, "specular": 0.1, "roughness": 0.7}
    light = _xyz(1e5 * LIGHT)  # far away; plotly.js turns it with the viewer
    shown = mesh(
        reached, i=i, j=j, k=k, cmin=0.0, cmax=float(length.max()), colorscale=SCALE,
        lighting=look, lightposition=light, hoverinfo="skip",
        colorbar={"orientation": "h", "y": 1.0, "yanchor": "bottom", "thickness": 10, "len": 0.6, "nticks": 5,
                  "title": {"text": "displacement, mm", "side": "top", "font": {"size": 12}}},
    )  # fmt: skip
    figure = Figure(shown, frames=[Frame(data=[mesh(step)], name=label) for step, label in enumerate(labels)])
    slider = [{"label": label, "method": "animate", "args": [[label], AT_ONCE]} for label in labels]
    axis = {"showbackground": False, "gridcolor": "#e1e4e8", "zeroline": False, "tickfont": {"size": 10}, "nticks": 5}
    low, high = position.min(axis=(0, 1)) - 0.5, position.max(axis=(0, 1)) + 0.5  # the same limits at all depths
    aspect = (high - low) / (high - low).max()
    normal = dataset.root["press/contact_normal"][press] @ dataset.root[f"{sensor}/pose"][press][:3, :3]
    _, up, out = camera(normal + OBLIQUE)
    figure.update_layout(
        template="none",
        margin={"l": 0, "r": 0, "t": 60, "b": 0},
        scene={
            "aspectmode": "manual",  # "data" would cut off flat bodies
            "aspectratio": _xyz(aspect),
            "camera": {"eye": _xyz(DISTANCE * out), "up": _xyz(up)},
            "dragmode": "orbit",
            **{f"{name}axis": {**axis, "title": {"text": f"{name}, mm", "font": {"size": 11}},
                               "range": [float(low[n]), float(high[n])]} for n, name in enumerate("xyz")},
        },
        sliders=[{"active": reached, "steps": slider, "x": 0.05, "len": 0.9, "pad": {"t": 10, "b": 10},
                  "currentvalue": {"prefix": prefix, "suffix": unit, "font": {"size": 13}}}],
    )  # fmt: skip
    return figure


def _xyz(values: np.ndarray) -> dict[str, float]:
    return dict(zip("xyz", map(float, values), strict=True))
