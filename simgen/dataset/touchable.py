"""Touchable surface of a sensor: its points, and the area that belongs to each point."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from simgen.dataset.reader import Dataset


@dataclass(frozen=True)
class TouchableSurface:
    """Touchable surface of a sensor at rest.

    vertices, triangles : (v, 3) m and outward (t, 3), of the whole sensor
    points : (n,) vertices of the touchable surface
    areas : (n,) m2, a third of each point's triangles whose corners are all touchable
    """

    vertices: np.ndarray
    triangles: np.ndarray
    points: np.ndarray
    areas: np.ndarray

    def on_vertices(self, values: np.ndarray) -> np.ndarray:
        """Spread values (n,) of the points to all vertices, (v,); NaN elsewhere."""
        whole = np.full(len(self.vertices), np.nan)
        whole[self.points] = values
        return whole


def touchable_points(dataset: Dataset | Mapping[str, np.ndarray], sensor: str) -> np.ndarray:
    """Vertices (n,) of a sensor's surface that can touch an indenter."""
    on_surface = np.unique(dataset[f"{sensor}/surface_triangles"])
    return on_surface[dataset[f"{sensor}/touchable"][on_surface]]


def touchable_surface(dataset: Dataset | Mapping[str, np.ndarray], sensor: str) -> TouchableSurface:
    """Find the touchable surface of a sensor, from a dataset or from the arrays of a plan."""
    vertices, triangles = dataset[f"{sensor}/rest_positions"], dataset[f"{sensor}/surface_triangles"]
    touchable = dataset[f"{sensor}/touchable"]
    points = touchable_points(dataset, sensor)
    a, b, c = np.swapaxes(vertices[triangles], 0, 1)
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1) * touchable[triangles].all(axis=1)
    areas = np.bincount(triangles.ravel(), np.repeat(area / 3, 3), minlength=len(vertices))[points]
    return TouchableSurface(vertices, triangles, points, areas)
