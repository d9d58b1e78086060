"""Maps of a sensor's unrolled skin: lateral arc against position along the finger (see `developed_skin`)."""

import numpy as np
import trimesh
from scipy.ndimage import label, zoom
from scipy.spatial import cKDTree

from simgen.errors import InputError
from simgen.geometry.developed_skin import Skin
from simgen.geometry.surface import ClosestPoint

GRID_M = 5e-4  # spacing of points on the skin
FINER = 2  # pixels of a map for each of these points, along each axis


class UnfoldedSkin:
    """Map of a closed surface.

    vertices : (vertex, 3), m
    triangles : (triangle, 3)
    shown : (vertex,) bool, True for vertices that the map shows
    extent : left, right, bottom, top edge of the map, mm: lateral arc, and position along the finger with the tip above

    Raises `InputError` if no skin can be unrolled.
    """

    def __init__(self, vertices: np.ndarray, triangles: np.ndarray, shown: np.ndarray):
        skin = Skin(trimesh.Trimesh(vertices, triangles, process=False))
        self.vertices = len(vertices)
        drawn = vertices[shown]
        half = np.pi * np.abs(drawn[:, 1:]).max()  # no cross-section is longer
        along = np.arange(drawn[:, 0].min(), drawn[:, 0].max() + GRID_M, GRID_M)
        arc = np.arange(-half, half + GRID_M, GRID_M)
        points, _ = skin.points(along[:, None], arc)
        points = zoom(points, (FINER, FINER, 1), order=1, grid_mode=False)
        known = np.isfinite(points).all(axis=2)
        on, _, face = ClosestPoint(vertices, triangles)(points[known])
        self._corners = triangles[face]
        self._weights = trimesh.triangles.points_to_barycentric(vertices[self._corners], on)
        # Interpolation makes a smooth outline. Separate parts are slivers of a rim.
        inside = np.zeros(known.shape, bool)
        inside[known] = np.einsum("pk,pk->p", shown[self._corners], self._weights) >= 0.5
        parts, _ = label(inside)
        drawn_here = (parts == _largest(parts))[known]
        known[known] = drawn_here
        if not known.any():
            raise InputError("a skin that cannot be unfolded: nothing of it is around the plane z = 0")
        self._corners, self._weights = self._corners[drawn_here], self._weights[drawn_here]
        self._points, self._known = on[drawn_here], known
        grid = np.meshgrid(
            np.linspace(arc[0], arc[-1], known.shape[1]), np.linspace(along[0], along[-1], known.shape[0])
        )
        self._flat = np.stack(grid, axis=-1)[known] * 1e3
        rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
        self._box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
        left, right = _edges(grid[0][0] * 1e3, self._box[1])
        top, bottom = _edges(grid[1][:, 0] * 1e3, self._box[0])
        self.extent = left, right, bottom, top

    def map(self, values: np.ndarray) -> np.ndarray:
        """Image (row, column) of values (vertex,); NaN where no skin is shown."""
        image = np.full(self._known.shape, np.nan)
        image[self._known] = np.einsum("pk,pk->p", values[self._corners], self._weights)
        return image[self._box]

    def place(self, points: np.ndarray) -> np.ndarray:
        """Map positions (n, 2), mm, of the shown skin that is nearest to points (n, 3), m."""
        return self._flat[cKDTree(self._points).query(points)[1]]


def _edges(middles: np.ndarray, part: slice) -> tuple[float, float]:
    """Outer edges of a part of a line of pixels."""
    half = 0.5 * (middles[1] - middles[0])
    return middles[part][0] - half, middles[part][-1] + half


def _largest(parts: np.ndarray) -> int:
    """Most frequent label except 0; -1, which no pixel has, if there is none."""
    count = np.bincount(parts.ravel())[1:]
    return 1 + int(count.argmax()) if len(count) else -1
