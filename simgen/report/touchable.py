"""The touchable surface of a sensor: its points, the area that each stands for, and maps drawn on it."""

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from simgen.dataset import Dataset
from simgen.drawing import FROM_OTHER_SIDE, FROM_PAD, draw_points, draw_surface
from simgen.touch_audit import touchable_points


@dataclass(frozen=True)
class TouchableSurface:
    """vertices (v, 3) m and outward triangles (t, 3) of the whole sensor, at rest

    points : (n,) vertices of the touchable surface
    areas : (n,) m2, a third of the triangles around each point of which all corners are touchable
    """

    vertices: np.ndarray
    triangles: np.ndarray
    points: np.ndarray
    areas: np.ndarray

    def on_vertices(self, values: np.ndarray) -> np.ndarray:
        """(v,) of values of the points (n,); NaN elsewhere."""
        whole = np.full(len(self.vertices), np.nan)
        whole[self.points] = values
        return whole


def touchable_surface(dataset: Dataset, sensor: str) -> TouchableSurface:
    vertices, triangles = dataset[f"{sensor}/rest_positions"], dataset[f"{sensor}/surface_triangles"]
    touchable = dataset[f"{sensor}/touchable"]
    points = touchable_points(dataset, sensor)
    a, b, c = np.swapaxes(vertices[triangles], 0, 1)
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1) * touchable[triangles].all(axis=1)
    areas = np.bincount(triangles.ravel(), np.repeat(area / 3, 3), minlength=len(vertices))[points]
    return TouchableSurface(vertices, triangles, points, areas)


def draw_map(
    surface: TouchableSurface,
    values: np.ndarray | None,
    title: str,
    label: str = "",
    *,
    largest: float = 1.0,
    contacts: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None,
) -> Figure:
    """Values (n,) of the touchable points, and contacts (points, normals, colours), seen from both sides of the pad."""
    figure = Figure(figsize=(3.9, 4.0), layout="constrained")
    figure.suptitle(title, fontsize=10)
    grid = figure.subplots(2, 1)
    for axes, view in zip(grid, (FROM_PAD, FROM_OTHER_SIDE), strict=True):
        shown = None if values is None else surface.on_vertices(values)
        faces = draw_surface(axes, surface.vertices, surface.triangles, shown, largest=largest, view=view)
        if contacts is not None:
            draw_points(axes, *contacts, view=view, size=16.0 if len(contacts[0]) < 100 else 5.0)
    if values is not None:
        figure.colorbar(faces, ax=list(grid), label=label, shrink=0.7)
    return figure
