"""The developed (unrolled) skin of a sensor: points by position along the finger and lateral arc length.

Shared frame, in metres: x along the finger, pad side -y, z lateral. The plane z = 0 meets the pad side in the centre
line. The arc length counts from there along the cross-section x = const, positive towards +z.
"""

from functools import lru_cache

import numpy as np
import trimesh

CREASE_DEG = 30.0  # normals are not averaged across sharper edges
LONE = np.array([-1, 0, 1, 2, 2, 1, 0, -1])  # corner alone on its side of a plane, by the sum of 2^k of corners above


def corner_normals(surface: trimesh.Trimesh) -> np.ndarray:
    """Unit normals (f, 3, 3) at the corners of faces: angle-weighted means of the faces around, up to a crease."""
    corners = surface.faces.ravel()
    order = np.argsort(corners, kind="stable")
    valence = np.bincount(corners, minlength=len(surface.vertices))
    first = np.cumsum(valence) - valence
    normals, angles = surface.face_normals[order // 3], surface.face_angles.ravel()[order]
    total = np.empty_like(normals)
    for number in np.unique(valence[valence > 0]):  # vertices with equally many corners together
        around = first[valence == number][:, None] + np.arange(number)  # (vertex, corner)
        own = normals[around]
        smooth = own @ own.swapaxes(1, 2) > np.cos(np.radians(CREASE_DEG))
        total[around] = (smooth * angles[around][:, None]) @ own
    found = np.empty_like(total)
    found[order] = total / np.linalg.norm(total, axis=1)[:, None]
    return found.reshape(-1, 3, 3)


@lru_cache(maxsize=4)
def skin_of(surface: trimesh.Trimesh) -> "Skin":
    """The skin of a surface. The process keeps the last ones; a surface that was changed is another one."""
    return Skin(surface)


class Skin:
    """A closed surface (m) with smooth normals, addressed by (x, arc).

    Corner 3 f + k is corner k of face f. Edge 3 f + k joins this corner and the next of the face.
    """

    def __init__(self, surface: trimesh.Trimesh):
        self.surface = surface
        vertices, faces = np.asarray(surface.vertices, dtype=np.float64), np.asarray(surface.faces, dtype=np.int64)
        self._points = vertices[faces].reshape(-1, 3)  # at corners
        self._normals = corner_normals(surface).reshape(-1, 3)
        corner = np.arange(faces.size).reshape(-1, 3)
        ends = np.stack([corner, np.roll(corner, -1, axis=1)], axis=2).reshape(-1, 2)
        # Both faces of an edge use the same order of its vertices: a plane cuts them at the very same point.
        order = np.argsort(faces.ravel()[ends], axis=1)
        self._ends = np.take_along_axis(ends, order, axis=1)
        low, high = faces.ravel()[self._ends].T
        self._across = _twins(low * len(vertices) + high)
        x, z = self._points[:, [0, 2]].T.reshape(2, -1, 3)
        self._middle = np.flatnonzero((z.min(axis=1) < 0.0) & (z.max(axis=1) >= 0.0))
        self._middle_x = x[self._middle].min(axis=1), x[self._middle].max(axis=1)

    def points(self, x: np.ndarray | float, arcs: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """Points (..., 3) m at lengths ``arcs`` along the cross-sections at ``x`` (both m), and unit normals (..., 3).

        ``x`` and ``arcs`` are of one shape (...), or broadcast to it. Both results are NaN if there is no such section,
        or if the arc would pass z = 0 again, opposite the pad.
        """
        x, arcs = np.broadcast_arrays(x, arcs)
        found = np.full((2, x.size, 3), np.nan)
        place, edges, t = self._walk(x.ravel(), arcs.ravel())
        points, normals = (
            _between(*(self._cut(values, edge, x.ravel()[place]) for edge in edges.T), t)
            for values in (self._points, self._normals)
        )
        found[:, place] = points, normals / np.sqrt(np.vecdot(normals, normals))[:, None]
        return found[0].reshape(*x.shape, 3), found[1].reshape(*x.shape, 3)

    def _walk(self, x: np.ndarray, arcs: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Walk from the centre line of the sections at ``x`` (n,) along ``arcs`` (n,), from face to face.

        Returns the m places that are reached: their numbers (m,), the two cut edges (m, 2) of the face there, and the
        fraction (m,) between these.
        """
        place, edges, fraction = self._centre(x)
        x, arcs = x[place], arcs[place]
        behind, ahead = (self._cut(self._points, edge, x) for edge in edges.T)
        onwards = (ahead[:, 2] > behind[:, 2]) == (arcs >= 0.0)  # True: leaves a face by the second of its edges
        length = np.linalg.norm(ahead - behind, axis=1)
        # Count from the near end of the first segment.
        left = np.abs(arcs) + length * np.where(onwards, fraction, 1.0 - fraction)
        at = np.where(onwards[:, None], ahead, behind)
        reached = np.ones(len(place), dtype=bool)
        walking = np.flatnonzero(left > length)
        while len(walking):
            left[walking] -= length[walking]
            entered = self._across[edges[walking, onwards[walking].astype(np.int64)]]
            both = self._cut_edges(entered // 3, x[walking])
            forwards = both[:, 0] == entered
            end = self._cut(self._points, np.where(forwards, both[:, 1], both[:, 0]), x[walking])
            step = np.linalg.norm(end - at[walking], axis=1)
            beyond = (end[:, 2] >= 0.0) != (at[walking, 2] >= 0.0)
            edges[walking], onwards[walking], length[walking], at[walking] = both, forwards, step, end
            reached[walking[beyond]] = False
            walking = walking[~beyond & (left[walking] > step)]
        t = left / length
        return place[reached], edges[reached], np.where(onwards, t, 1.0 - t)[reached]

    def _centre(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Find where the sections at ``x`` (n,) cross z = 0 on the pad side.

        Returns the numbers (m,) of the sections that exist, the two cut edges (m, 2) of the face there, and the
        fraction (m,) between these.
        """
        first, last = self._middle_x
        place, middle = np.nonzero((first < x[:, None]) & (last >= x[:, None]))
        edges = self._cut_edges(self._middle[middle], x[place])
        (_, y, z), (_, next_y, next_z) = (self._cut(self._points, edge, x[place]).T for edge in edges.T)
        crosses = (z >= 0.0) != (next_z >= 0.0)
        place, edges, y, z, next_y, next_z = (each[crosses] for each in (place, edges, y, z, next_y, next_z))
        t = z / (z - next_z)
        order = np.lexsort(((1.0 - t) * y + t * next_y, place))
        place, lowest = np.unique(place[order], return_index=True)
        return place, edges[order][lowest], t[order][lowest]

    def _cut_edges(self, faces: np.ndarray, x: np.ndarray) -> np.ndarray:
        """The two edges (n, 2) of each face (n,) that the plane at ``x`` (n,) crosses.

        A vertex in the plane counts as above it. So the plane crosses exactly two edges of every cut face, and the
        segments between these form closed loops.
        """
        above = self._points[3 * faces[:, None] + np.arange(3), 0] >= x[:, None]
        lone = LONE[above @ np.array([1, 2, 4])]
        return 3 * faces[:, None] + np.stack([lone, (lone + 2) % 3], axis=1)

    def _cut(self, values: np.ndarray, edges: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Interpolate values (corner, 3) to where edges (n,) cross the planes at ``x`` (n,): (n, 3)."""
        a, b = self._ends[edges].T
        return _between(values[a], values[b], (x - self._points[a, 0]) / (self._points[b, 0] - self._points[a, 0]))


def _between(start: np.ndarray, end: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Interpolate from ``start`` (n, 3) to ``end`` (n, 3) by fractions ``t`` (n,)."""
    return (1.0 - t)[:, None] * start + t[:, None] * end


def _twins(ids: np.ndarray) -> np.ndarray:
    """The index (n,) of the other element with the same id, for ``ids`` (n,) that hold each id twice."""
    one, other = np.argsort(ids, kind="stable").reshape(-1, 2).T
    twins = np.empty(len(ids), dtype=np.int64)
    twins[one], twins[other] = other, one
    return twins
