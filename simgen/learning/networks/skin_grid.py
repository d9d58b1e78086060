"""A pixel grid over the developed skins of two sensors, on which contacts lie at the same place of both.

Rows run along the finger (x), columns along the lateral arc (see `simgen.geometry.developed_skin`). Columns are
symmetric about the centre line, so that a sensor's mirror image in z = 0 is a flip of the columns.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from simgen.geometry.developed_skin import Skin
from simgen.geometry.surface import ClosestPoint

LEAST_PIXELS = 2  # along each axis: values are interpolated between them
FINER = 4  # samples of the skin per pixel, along each axis, among which the place of a point is sought
STEPS = 3  # of Gauss and Newton from there towards the foot of the perpendicular


@dataclass(frozen=True)
class PixelGrid:
    """Pixels of the unrolled skin: ``x`` (row,) and ``arc`` (column,), middles in m."""

    x: np.ndarray
    arc: np.ndarray

    @classmethod
    def over(cls, first_x: float, last_x: float, largest_arc: float, pixel: float, multiple: int) -> Self:
        """Cover a box (m) with pixels; their numbers are multiples of ``multiple``."""
        rows, columns = (
            multiple * -(-max(int(np.ceil(length / pixel)), LEAST_PIXELS) // multiple)
            for length in (last_x - first_x, 2 * largest_arc)
        )
        middle = 0.5 * (first_x + last_x)
        return cls(middle + pixel * (np.arange(rows) - 0.5 * (rows - 1)),
                   pixel * (np.arange(columns) - 0.5 * (columns - 1)))  # fmt: skip

    @property
    def shape(self) -> tuple[int, int]:
        return len(self.x), len(self.arc)


@dataclass(frozen=True)
class Places:
    """Points of a sensor by their place on its skin.

    x, arc : (n,) m
    frames : (n, 3, 3) rows: outward normal, tangent along the finger, tangent along the arc
    offset : (n, 3) m, from the skin to the point in this frame; its first number is minus the depth
    """

    x: np.ndarray
    arc: np.ndarray
    frames: np.ndarray
    offset: np.ndarray


class SkinOnGrid:
    """A sensor's skin on a grid.

    vertices, triangles : (v, 3) m and (t, 3), of the whole sensor
    shown : (v,) bool, True for vertices of the skin
    """

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray, shown: np.ndarray, grid: PixelGrid):
        self.grid, self.triangles = grid, triangles
        self.vertices = np.asarray(vertices, np.float64)
        self.skin = Skin(trimesh.Trimesh(self.vertices, triangles, process=False))
        self.points, self.normals = self.skin.points(grid.x[:, None], grid.arc)
        on_skin = np.isfinite(self.points).all(axis=2)
        closest, _, face = ClosestPoint(self.vertices, triangles)(self.points[on_skin])
        weights = trimesh.triangles.points_to_barycentric(self.vertices[triangles[face]], closest)
        self.known = np.zeros(grid.shape, bool)  # pixels with skin
        self.known[on_skin] = np.einsum("pk,pk->p", shown[triangles[face]], weights) >= 0.5
        self.corners = np.zeros((*grid.shape, 3), np.int64)
        self.weights = np.zeros((*grid.shape, 3))  # of the corners; 0 off the skin
        chosen = self.known[on_skin]
        self.corners[self.known], self.weights[self.known] = triangles[face][chosen], weights[chosen]

    @cached_property
    def frames(self) -> np.ndarray:
        """Frames (row, column, 3, 3) of the pixels; 0 off the skin."""
        found = np.zeros((*self.grid.shape, 3, 3))
        found[self.known] = frames_of(self.normals[self.known])
        return found

    def places(self, points: np.ndarray) -> Places:
        """Place points (n, 3), m, at the foot of their perpendicular to the skin within the grid, or at its edge."""
        nearest_x, nearest_arc = self._nearest_sample(points)
        pixel = self.grid.x[1] - self.grid.x[0]
        x, arc = nearest_x, nearest_arc
        for _ in range(STEPS):
            step = np.clip(self._towards(points, x, arc, 0.1 * pixel), -pixel / FINER, pixel / FINER)
            x = np.clip(x + step[:, 0], self.grid.x[0], self.grid.x[-1])
            arc = np.clip(arc + step[:, 1], self.grid.arc[0], self.grid.arc[-1])
        lost = np.isnan(self.skin.points(x, arc)[0]).any(axis=1)  # they stepped off an edge
        x, arc = np.where(lost, nearest_x, x), np.where(lost, nearest_arc, arc)
        foot, normals = self.skin.points(x, arc)
        frames = frames_of(normals)
        return Places(x, arc, frames, np.einsum("nij,nj->ni", frames, points - foot))

    def _nearest_sample(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates x and arc (n,), m, of the samples of the skin that are nearest to points (n, 3)."""
        x, arc = (np.linspace(axis[0], axis[-1], FINER * (len(axis) - 1) + 1) for axis in (self.grid.x, self.grid.arc))
        samples, _ = self.skin.points(x[:, None], arc)
        row, column = np.nonzero(np.isfinite(samples).all(axis=2))
        nearest = cKDTree(samples[row, column]).query(points)[1]
        return x[row[nearest]], arc[column[nearest]]

    def _towards(self, points: np.ndarray, x: np.ndarray, arc: np.ndarray, step: float) -> np.ndarray:
        """Steps (n, 2) in x and arc, m; 0 beside an edge of the skin."""
        on, _ = self.skin.points(x, arc)
        along, across = (
            (self.skin.points(x + dx, arc + da)[0] - self.skin.points(x - dx, arc - da)[0]) / (2.0 * step)
            for dx, da in ((step, 0.0), (0.0, step))
        )
        jacobian = np.stack([along, across], axis=2)
        square = np.einsum("nij,nik->njk", jacobian, jacobian)
        right = np.einsum("nij,ni->nj", jacobian, points - on)
        usable = np.isfinite(square).all(axis=(1, 2)) & np.isfinite(right).all(axis=1)
        found = np.zeros((len(points), 2))
        found[usable] = np.linalg.solve(square[usable] + 1e-6 * np.eye(2), right[usable, :, None])[:, :, 0]
        return found


def frames_of(normals: np.ndarray) -> np.ndarray:
    """Frames (n, 3, 3) of unit normals (n, 3): normal, tangent along the finger, tangent along the arc."""
    across = np.cross(normals, [1.0, 0.0, 0.0])
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    return np.stack([normals, np.cross(across, normals), across], axis=1)


def reach_along_arc(vertices: np.ndarray, triangles: np.ndarray, shown: np.ndarray, pixel: float) -> float:
    """Largest arc length (m) at which a skin, of vertices (v, 3) that are ``shown`` (v,), is found."""
    skin = vertices[shown]
    half = np.pi * np.abs(skin[:, 1:]).max()  # no cross-section is longer
    grid = PixelGrid.over(skin[:, 0].min(), skin[:, 0].max(), half, pixel, 1)
    return float(np.abs(grid.arc[SkinOnGrid(vertices, triangles, shown, grid).known.any(axis=0)]).max(initial=pixel))
