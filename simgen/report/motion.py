"""Animated press: all sensors side by side, with the outline of the indenter."""

import html
from collections.abc import Iterator

import numpy as np
import pyvista
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from scipy.spatial import ConvexHull

from simgen.config.indenter_path import moved
from simgen.config.warp_device import start_warp
from simgen.dataset.pressed_indenters import pressed_indenters
from simgen.dataset.reader import Dataset
from simgen.errors import InputError
from simgen.plotting.html import image
from simgen.plotting.surface_plot import camera, draw_surface, gif
from simgen.report.choice import NOTHING_YET, furthest_press
from simgen.sensors.indenter_pose import advanced

FRAME_MS, HOLD_MS = 180, 1200  # for each depth, and for the last one
SHAFT_M = 5e-3  # length of the indenter that is drawn
TILT = 0.55  # share of the contact normal in the direction to the viewer, who looks from the side
STEEL = "#5b7c99"


def motion_section(dataset: Dataset) -> Iterator[str]:
    press, reached = furthest_press(dataset)
    if not reached:
        yield NOTHING_YET
        return
    name = dataset.indenters[dataset["press/indenter"][press]]
    yield (
        f"<p>Press {press}, {html.escape(name)}, from rest to {dataset.indenter_path.label(reached - 1)}, in a side "
        "view. No press goes further on all sensors. Colour: length of the displacement. Blue: convex outline of the "
        "indenter, left out if the indenter's file has changed.</p>"
    )
    yield image(animated_press(dataset, press, reached), "gif", f"press {press}, {name}")


def animated_press(dataset: Dataset, press: int, reached: int) -> bytes:
    """Make a GIF of a press, at rest and at the depths reached."""
    sides = [_Side(dataset, sensor, press, reached) for sensor in dataset.sensors]
    largest = max(np.linalg.norm(side.displacement, axis=-1).max() for side in sides) * 1e3
    figure = Figure(figsize=(2.5 * len(sides) + 0.8, 2.1), dpi=140, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    grid = np.atleast_1d(figure.subplots(1, len(sides)))
    frames = []
    for step in range(-1, reached):
        for axes, side in zip(grid, sides, strict=True):
            axes.clear()
            faces = side.draw(axes, step, largest)
        if step < 0:
            figure.colorbar(faces, ax=list(grid), label="displacement, mm", shrink=0.7)
            canvas.draw()
            figure.set_layout_engine("none")  # the axes stay in place from frame to frame
        canvas.draw()
        frames.append(np.array(canvas.buffer_rgba()))
    return gif(frames, FRAME_MS, HOLD_MS)


class _Side:
    """A press on one sensor, in a view in which the indenter comes from above."""

    def __init__(self, dataset: Dataset, sensor: str, press: int, reached: int):
        self.sensor, self._path = sensor, dataset.indenter_path
        self.displacement = dataset.displacement(sensor, press, slice(0, reached))
        self._pose = dataset.root[f"{sensor}/pose"][press]
        self._rest = dataset[f"{sensor}/rest_positions"]
        self._triangles = dataset[f"{sensor}/surface_triangles"]
        normal = dataset.root["press/contact_normal"][press]
        finger = np.array([1.0, 0.0, 0.0]) if abs(normal[0]) < 0.9 else np.array([0.0, 0.0, 1.0])
        self._view = camera(np.cross(finger, normal) + TILT * normal, up=normal)
        self._first_touch = advanced(dataset["press/pose"][press], dataset[f"{sensor}/touch"][press])
        self._tip = _tip(dataset, press)

    def draw(self, axes: Axes, step: int, largest: float) -> PolyCollection:
        """Draw a step, or the gel at rest for -1, always within the same limits."""
        displacement = self.displacement[step] if step >= 0 else np.zeros_like(self._rest)
        vertices = (self._rest + displacement) @ self._pose[:3, :3].T + self._pose[:3, 3]
        length = np.linalg.norm(displacement, axis=1) * 1e3
        faces = draw_surface(axes, vertices, self._triangles, length, largest=largest, view=self._view)
        seen = (self._rest @ self._pose[:3, :3].T + self._pose[:3, 3]) @ self._view[:2].T * 1e3
        if self._tip is not None:
            outline = self._outline(step)
            axes.add_patch(Polygon(outline, facecolor=STEEL, alpha=0.3))
            axes.add_patch(Polygon(outline, fill=False, edgecolor=STEEL, linewidth=1.2))
            seen = np.concatenate([seen, self._outline(-1)])
        (left, bottom), (right, top) = seen.min(axis=0) - 0.5, seen.max(axis=0) + 0.5
        axes.set(xlim=(left, right), ylim=(bottom, top))
        depth_mm = 1e3 * self._path.depths_m[step] if step >= 0 else 0.0
        axes.set_title(f"{self.sensor}, {depth_mm:.2f} mm", fontsize=10)
        return faces

    def _outline(self, step: int) -> np.ndarray:
        """Convex hull (n, 2), mm, of the indenter's tip in the view."""
        pose = self._first_touch
        if step >= 0:
            pose = moved(pose, self._path.offsets_m[step], self._path.turns_rad[step])
        seen = (self._tip @ pose[:3, :3].T + pose[:3, 3]) @ self._view[:2].T * 1e3
        return seen[ConvexHull(seen).vertices]


def _tip(dataset: Dataset, press: int) -> np.ndarray | None:
    """Points (n, 3), m, of the press's indenter in its frame; None if its file has changed."""
    start_warp()
    try:
        indenter = pressed_indenters(dataset)[dataset["press/indenter"][press]]
    except InputError:
        return None
    return np.asarray(pyvista.wrap(indenter.mesh()).clip("y", origin=(0.0, -SHAFT_M, 0.0), invert=False).points)
