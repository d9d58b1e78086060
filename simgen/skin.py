"""The developed (unrolled) skin of a sensor: its surface by position along the finger and lateral arc length.

Shared frame, metres: x along the finger, pad side -y, z lateral. The centre line is where the plane z = 0
meets the pad side; the arc length counts from it along the cross-section x = const, positive towards +z.
"""

import numpy as np
import trimesh

CREASE_DEG = 30.0  # faces that meet at a larger angle keep their own normals


def corner_normals(surface: trimesh.Trimesh) -> np.ndarray:
    """Unit normals (f, 3, 3) at the corners of faces, angle-weighted over the faces around up to a crease."""
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

    def point(self, x: float, arc: float) -> tuple[np.ndarray, np.ndarray] | None:
        """The point (3,) at arc length ``arc`` (m) of the cross-section at ``x`` (m), its unit normal (3,).

        None where there is no such section, or the arc is longer than half of the section's loop.
        """
        ends, points, normals = self._section(x)
        start = self._centre(points)
        if start is None:
            return None
        segment, fraction = start
        forward = int((points[segment, 1, 2] > points[segment, 0, 2]) == (arc >= 0.0))
        loop = self._walk(ends, segment, forward)
        # From the centre line to the end of its segment, then whole segments, each entered at its near end.
        near = np.array([points[s, 1 - side] for s, side in loop])
        far = np.array([points[s, side] for s, side in loop])
        centre = (1.0 - fraction) * points[segment, 0] + fraction * points[segment, 1]
        near[0] = centre
        reached = np.concatenate([[0.0], np.cumsum(np.linalg.norm(far - near, axis=1))])
        length = abs(arc)
        if length > 0.5 * reached[-1]:
            return None
        index = int(np.searchsorted(reached, length, side="right")) - 1
        s, _ = loop[index]
        t = (length - reached[index]) / (reached[index + 1] - reached[index])
        position = (1.0 - t) * near[index] + t * far[index]
        along = np.linalg.norm(position - points[s, 0]) / np.linalg.norm(points[s, 1] - points[s, 0])
        normal = (1.0 - along) * normals[s, 0] + along * normals[s, 1]
        return position, normal / np.linalg.norm(normal)

    def _section(self, x: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Segments of the plane's cut: ids (s, 2) of the edges that each joins, points and normals (s, 2, 3).

        A vertex in the plane counts as above it, so every cut face is crossed at exactly two edges and, the
        surface being closed, the segments form closed loops.
        """
        above = self._vertices[:, 0] >= x
        inside = above[self._faces]
        cut = np.flatnonzero(inside.any(axis=1) & ~inside.all(axis=1))
        faces, inside = self._faces[cut], inside[cut]
        # The lone corner is the one on its own side; the cut runs over the two edges that leave it.
        lone = np.where((inside.sum(axis=1) == 1)[:, None], inside, ~inside).argmax(axis=1)
        rows = np.arange(len(cut))
        ends, points, normals = [], [], []
        for step in (1, 2):
            other = (lone + step) % 3
            a, b = faces[rows, lone], faces[rows, other]
            t = ((x - self._vertices[a, 0]) / (self._vertices[b, 0] - self._vertices[a, 0]))[:, None]
            ends.append(np.minimum(a, b).astype(np.int64) * len(self._vertices) + np.maximum(a, b))
            points.append((1.0 - t) * self._vertices[a] + t * self._vertices[b])
            normals.append((1.0 - t) * self._normals[cut, lone] + t * self._normals[cut, other])
        return np.stack(ends, axis=1), np.stack(points, axis=1), np.stack(normals, axis=1)

    @staticmethod
    def _centre(points: np.ndarray) -> tuple[int, float] | None:
        """The segment that crosses z = 0 on the pad side, and the fraction of it where it does."""
        z = points[:, :, 2]
        crossing = np.flatnonzero((z[:, 0] >= 0.0) != (z[:, 1] >= 0.0))
        if len(crossing) == 0:
            return None
        t = z[crossing, 0] / (z[crossing, 0] - z[crossing, 1])
        y = (1.0 - t) * points[crossing, 0, 1] + t * points[crossing, 1, 1]
        lowest = int(y.argmin())
        return int(crossing[lowest]), float(t[lowest])

    @staticmethod
    def _walk(ends: np.ndarray, segment: int, forward: int) -> list[tuple[int, int]]:
        """The loop from ``segment``, left over its end ``forward``: (segment, end over which it is left)."""
        at_edge: dict[int, list[tuple[int, int]]] = {}
        for index, pair in enumerate(ends.tolist()):
            for side in (0, 1):
                at_edge.setdefault(pair[side], []).append((index, side))
        loop = [(segment, forward)]
        while True:
            index, side = loop[-1]
            here = at_edge[int(ends[index, side])]
            following, entered = here[0] if here[1][0] == index else here[1]
            if following == segment:
                return loop
            loop.append((following, 1 - entered))
