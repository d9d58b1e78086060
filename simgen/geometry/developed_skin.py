"""The developed (unrolled) skin of a sensor: points by position along the finger and lateral arc length.

Shared frame, in metres: x along the finger, pad side -y, z lateral. The plane z = 0 meets the pad side in the centre
line. The arc length counts from there along the cross-section x = const, positive towards +z.
"""

from collections.abc import Iterable

import numpy as np
import trimesh

CREASE_DEG = 30.0  # normals are not averaged across sharper edges


def corner_normals(surface: trimesh.Trimesh) -> np.ndarray:
    """Unit normals (f, 3, 3) at the corners of faces: angle-weighted means of the faces around, up to a crease."""
    corners = surface.faces.ravel()
    order = np.argsort(corners, kind="stable")
    valence = np.bincount(corners, minlength=len(surface.vertices))
    first = np.concatenate([[0], np.cumsum(valence)[:-1]])
    vertex = corners[order]
    rank = np.arange(len(order)) - first[vertex]
    own = surface.face_normals[order // 3]
    angle = surface.face_angles.ravel()[order]
    total = np.zeros_like(own)
    for shift in range(valence.max()):
        has_partner = np.flatnonzero(valence[vertex] > shift)
        v = vertex[has_partner]
        partner = first[v] + (rank[has_partner] + shift) % valence[v]
        normal = own[partner]
        smooth = np.einsum("ni,ni->n", normal, own[has_partner]) > np.cos(np.radians(CREASE_DEG))
        total[has_partner] += (smooth * angle[partner])[:, None] * normal
    normals = np.empty_like(total)
    normals[order] = total / np.linalg.norm(total, axis=1)[:, None]
    return normals.reshape(-1, 3, 3)


class Skin:
    """A closed surface (m) with smooth normals, addressed by (x, arc)."""

    def __init__(self, surface: trimesh.Trimesh):
        self.surface = surface
        self._vertices = np.asarray(surface.vertices, dtype=np.float64)
        self._faces = np.asarray(surface.faces)
        self._normals = corner_normals(surface)
        x = self._vertices[self._faces, 0]
        self._order = np.argsort(x.min(axis=1), kind="stable")
        self._first_x, self._last_x = x.min(axis=1)[self._order], x.max(axis=1)[self._order]
        self._longest = np.ptp(x, axis=1).max() * (1.0 + 1e-9)

    def point(self, x: float, arc: float) -> tuple[np.ndarray, np.ndarray] | None:
        """The point (3,) at arc length ``arc`` of the cross-section at ``x`` (both m), and its unit normal (3,).

        None if there is no such section, or if the arc would pass z = 0 again, opposite the pad.
        """
        return self.points(x, (arc,))[0]

    def points(self, x: float, arcs: Iterable[float]) -> list[tuple[np.ndarray, np.ndarray] | None]:
        """Points and normals, as by `point`, at many arc lengths of one cross-section. The section is cut once."""
        ends, points, normals = self._section(x)
        start = _centre(points)
        if start is None:
            return [None for _ in arcs]
        neighbour = _neighbours(ends)
        length = np.linalg.norm(points[:, 1] - points[:, 0], axis=1)
        found = []
        for arc in arcs:
            end = _walk(arc, *start, points, length, neighbour)
            found.append(None if end is None else _between(*end, points, normals))
        return found

    def _section(self, x: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Segments of a cut: ids (s, 2) of the edges that each joins, end points and normals (s, 2, 3).

        A vertex in the plane counts as above it. So the plane crosses exactly two edges of every cut face, and the
        segments form closed loops.
        """
        near = slice(*np.searchsorted(self._first_x, [x - self._longest, x]))
        cut = self._order[near][self._last_x[near] >= x]
        above = self._vertices[self._faces[cut], 0] >= x
        # The lone corner is alone on its side of the plane; the cut crosses its two edges.
        lone = np.where((above.sum(axis=1) == 1)[:, None], above, ~above).argmax(axis=1)
        faces, rows = self._faces[cut], np.arange(len(cut))
        ends, points, normals = [], [], []
        for step in (1, 2):
            other = (lone + step) % 3
            # Both faces of an edge use the same order of its vertices: they meet at the very same point.
            swap = faces[rows, lone] > faces[rows, other]
            low, high = np.where(swap, other, lone), np.where(swap, lone, other)
            a, b = faces[rows, low], faces[rows, high]
            t = ((x - self._vertices[a, 0]) / (self._vertices[b, 0] - self._vertices[a, 0]))[:, None]
            ends.append(a.astype(np.int64) * len(self._vertices) + b)
            points.append((1.0 - t) * self._vertices[a] + t * self._vertices[b])
            normals.append((1.0 - t) * self._normals[cut, low] + t * self._normals[cut, high])
        return np.stack(ends, axis=1), np.stack(points, axis=1), np.stack(normals, axis=1)


def _centre(points: np.ndarray) -> tuple[int, float] | None:
    """The segment of ``points`` (s, 2, 3) that crosses z = 0 on the pad side, and the fraction along it."""
    z = points[:, :, 2]
    crossing = np.flatnonzero((z[:, 0] >= 0.0) != (z[:, 1] >= 0.0))
    if len(crossing) == 0:
        return None
    t = z[crossing, 0] / (z[crossing, 0] - z[crossing, 1])
    y = (1.0 - t) * points[crossing, 0, 1] + t * points[crossing, 1, 1]
    lowest = int(y.argmin())
    return int(crossing[lowest]), float(t[lowest])


def _walk(
    arc: float, segment: int, fraction: float, points: np.ndarray, length: np.ndarray, neighbour: np.ndarray
) -> tuple[int, float] | None:
    """Segment and fraction at an arc length from the centre; None if the arc passes z = 0 opposite the pad."""
    side = int((points[segment, 1, 2] > points[segment, 0, 2]) == (arc >= 0.0))
    # Count from the near end of the first segment.
    target = abs(arc) + length[segment] * (fraction if side == 1 else 1.0 - fraction)
    first = segment
    while target > length[segment]:
        target -= length[segment]
        segment, entered = neighbour[segment, side]
        side = 1 - entered
        if segment == first or (points[segment, 0, 2] >= 0.0) != (points[segment, 1, 2] >= 0.0):
            return None
    t = target / length[segment]
    return segment, t if side == 1 else 1.0 - t


def _between(segment: int, t: float, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Point and unit normal at a fraction of a segment."""
    normal = (1.0 - t) * normals[segment, 0] + t * normals[segment, 1]
    return (1.0 - t) * points[segment, 0] + t * points[segment, 1], normal / np.linalg.norm(normal)


def _neighbours(ends: np.ndarray) -> np.ndarray:
    """Segment and side (s, 2, 2) that each side of each segment meets. ``ends`` (s, 2) has each id twice."""
    order = np.argsort(ends.ravel(), kind="stable").reshape(-1, 2)
    partner = np.empty(ends.size, dtype=np.int64)
    partner[order[:, 0]], partner[order[:, 1]] = order[:, 1], order[:, 0]
    return np.stack([partner // 2, partner % 2], axis=1).reshape(-1, 2, 2)
