"""The surface of a sensor as three.js draws it: triangles and positions in mm, at rest and pressed."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Self

import numpy as np
import trimesh

from simgen.dataset.reader import Dataset
from simgen.units import MM_PER_M

PRESSES_KEPT = 4  # for each sensor; 20 depths of 6,000 vertices take 1.4 MB
CREASE_DEG = 40.0
AT_REST = -1  # number of the step at which the indenter first touches, and the gel is at rest


@dataclass(frozen=True)
class DrawnSurface:
    """Surface of a sensor at rest, in its frame, without the vertices within.

    vertices : (v,) its vertices in the output mesh; one at a crease of the surface counts once for each side, so that
        shading shows the crease
    triangles : (f, 3) int32, outward, numbers of the v vertices
    rest_mm : (v, 3) float32, mm
    """

    vertices: np.ndarray
    triangles: np.ndarray
    rest_mm: np.ndarray

    @classmethod
    def of_mesh(cls, rest_positions: np.ndarray, surface_triangles: np.ndarray) -> Self:
        """Surface of an output mesh: positions (n, 3) m and outward triangles (f, 3)."""
        side = np.repeat(_smooth_sides(rest_positions, surface_triangles), 3)
        corners, triangles = np.unique([surface_triangles.ravel(), side], axis=1, return_inverse=True)
        rest = np.float32(MM_PER_M * rest_positions[corners[0]])
        return cls(corners[0], triangles.reshape(-1, 3).astype(np.int32), rest)

    @classmethod
    def of_dataset(cls, dataset: Dataset, sensor: str) -> Self:
        return cls.of_mesh(dataset[f"{sensor}/rest_positions"], dataset[f"{sensor}/surface_triangles"])

    @cached_property
    def in_outputs(self) -> np.ndarray:
        """(v,) place of each vertex in outputs at the surface, whose points are the surface's vertices, rising."""
        return np.unique(self.vertices, return_inverse=True)[1]

    def displaced(self, displacement: np.ndarray) -> np.ndarray:
        """Positions (v, 3) float32, mm, after a displacement (n, 3) m of the whole mesh; at rest where that is NaN."""
        return self.moved(displacement[self.vertices])

    def moved(self, displacement: np.ndarray) -> np.ndarray:
        """Positions (..., v, 3) float32, mm, after a displacement (..., v, 3) m of the surface alone."""
        return self.rest_mm + np.float32(MM_PER_M * np.nan_to_num(displacement))


def _smooth_sides(positions: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Number (f,) of the side that each triangle belongs to. Creases of more than `CREASE_DEG` part the sides."""
    surface = trimesh.Trimesh(positions, triangles, process=False)
    smooth = surface.face_adjacency_angles < np.radians(CREASE_DEG)
    return trimesh.graph.connected_component_labels(surface.face_adjacency[smooth], len(triangles))


class PressedSurface:
    """Surface of one sensor of a dataset in every press.

    A whole press is read at once, because its samples lie side by side in one file. The last ones are kept.
    """

    def __init__(self, dataset: Dataset, sensor: str):
        self.dataset, self.sensor = dataset, sensor
        self.surface = DrawnSurface.of_dataset(dataset, sensor)
        self._read = lru_cache(PRESSES_KEPT)(
            lambda press: np.float32(dataset.displacement(sensor, press)[:, self.surface.vertices])
        )

    def displacement(self, press: int) -> np.ndarray:
        """Displacement (depth, v, 3) float32, m, of the surface; NaN where not reached or not there yet.

        Raises `InputError` if the file cannot be read.
        """
        return self._read(int(press))

    def is_reached(self, press: int, step: int) -> bool:
        return step == AT_REST or bool(np.isfinite(self.displacement(press)[step]).all())

    def positions(self, press: int, step: int) -> np.ndarray:
        """Positions (v, 3) float32, mm, at a step or `AT_REST`; at rest if the press did not reach the step."""
        if step == AT_REST:
            return self.surface.rest_mm
        return self.surface.moved(self.displacement(press)[step])
