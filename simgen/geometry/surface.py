"""Queries on triangulated surfaces: closest points, small pieces in a ball, smooth patches, shells, volume."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

CREASE_DEG = 40.0  # sharper edges are creases: a chamfer's (45), not a fillet's with 3 facets per quarter turn (30)


class ClosestPoint:
    """Exact closest points on triangles, by a k-d tree of centroids.

    Large triangles are split first, so that every point of a piece is near its centroid.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray):
        longest = np.ptp(vertices[faces].reshape(-1, 3), axis=0).max() / 25.0
        pieces, piece_faces, self.owner = trimesh.remesh.subdivide_to_size(
            vertices, faces, longest, max_iter=60, return_index=True
        )
        self.scale = 1.0 / longest  # scales lengths to about 1, because trimesh has absolute tolerances
        self.triangles = pieces[piece_faces] * self.scale
        centroids = self.triangles.mean(axis=1)
        self.reach = np.linalg.norm(self.triangles - centroids[:, None], axis=2).max()
        self.tree = cKDTree(centroids)

    def __call__(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Closest points (n, 3), distances (n,) and indices of faces (n,) for points (n, 3)."""
        points = np.asarray(points, dtype=float) * self.scale
        closest = np.empty_like(points)
        distance = np.empty(len(points))
        piece = np.empty(len(points), dtype=np.int64)
        todo = np.arange(len(points))
        k = min(8, len(self.triangles))
        while len(todo):
            away, near = self.tree.query(points[todo], k=range(1, k + 1))
            on = trimesh.triangles.closest_point(
                self.triangles[near.ravel()], np.repeat(points[todo], k, axis=0)
            ).reshape(len(todo), k, 3)
            gap = np.linalg.norm(on - points[todo, None], axis=2)
            best = gap.argmin(axis=1)
            row = np.arange(len(todo))
            closest[todo], distance[todo], piece[todo] = on[row, best], gap[row, best], near[row, best]
            # A piece that was not tried lies at least (distance of its centroid - reach) away.
            sure = (gap[row, best] <= away[:, -1] - self.reach) | (k == len(self.triangles))
            todo = todo[~sure]
            k = min(4 * k, len(self.triangles))
        return closest / self.scale, distance / self.scale, self.owner[piece]


class FinePieces:
    """Triangles (f, 3, 3) that are subdivided on demand, only inside the balls of a query.

    Memory and time depend on the number of pieces in the balls, not on the size of the surface.
    """

    def __init__(self, triangles: np.ndarray):
        self.measured = _measured(triangles)
        _, centroids, sizes, _ = self.measured
        self.reach = sizes.max()
        self.tree = cKDTree(centroids)

    def near(
        self,
        centres: np.ndarray,
        radii: np.ndarray,
        longest: np.ndarray,
        among: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pieces (p, 3, 3) that may reach into one of n balls, and the ball (p,) and the triangle (p,) of each.

        The balls have ``centres`` (n, 3) and ``radii`` (n,). A piece with an edge above ``longest`` (n,) of its ball is
        split into four at the middles of its edges. ``among`` selects from pairs of balls (q,) and triangles (q,): it
        returns a mask (q,).
        """
        ball, owner = self._around(centres, radii.max(initial=0.0))
        if among is not None:
            selected = among(ball, owner)
            ball, owner = ball[selected], owner[selected]
        pieces, centroids, sizes, edges = (each[owner] for each in self.measured)
        found = [(np.empty((0, 3, 3)), np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64))]
        while len(pieces):
            close = np.linalg.norm(centroids - centres[ball], axis=1) <= radii[ball] + sizes
            short = edges <= longest[ball]
            found.append(tuple(each[close & short] for each in (pieces, ball, owner)))
            ball, owner = (np.repeat(each[close & ~short], 4) for each in (ball, owner))
            pieces, centroids, sizes, edges = _measured(_quarters(pieces[close & ~short]))
        return tuple(np.concatenate(each) for each in zip(*found, strict=True))

    def _around(self, centres: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
        """Pairs of balls (q,) and triangles (q,): all that meet, for balls about ``centres`` (n, 3) of one radius."""
        pairs = cKDTree(centres).sparse_distance_matrix(self.tree, radius + self.reach, output_type="ndarray")
        return pairs["i"], pairs["j"]


def _measured(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Triangles (t, 3, 3), their centroids (t, 3), radii about these (t,) and longest edges (t,)."""
    centroids = triangles.mean(axis=1)
    sizes = np.linalg.norm(triangles - centroids[:, None], axis=2).max(axis=1)
    edges = np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2).max(axis=1)
    return triangles, centroids, sizes, edges


def _quarters(triangles: np.ndarray) -> np.ndarray:
    """Split triangles (t, 3, 3) at the middles of their edges: (4 t, 3, 3)."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    quarters = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
    return np.array(quarters).transpose(2, 0, 1, 3).reshape(-1, 3, 3)  # the four of a triangle in a row


def smooth_patches(surface: trimesh.Trimesh, region: np.ndarray | None = None) -> np.ndarray:
    """Label (f,) of each face's smooth patch. Patches end at edges sharper than `CREASE_DEG`.

    Given labels ``region`` (f,), patches also end where these differ.
    """
    joined = surface.face_adjacency_angles < np.radians(CREASE_DEG)
    if region is not None:
        joined &= region[surface.face_adjacency[:, 0]] == region[surface.face_adjacency[:, 1]]
    smooth = surface.face_adjacency[joined]
    n = len(surface.faces)
    graph = coo_matrix((np.ones(len(smooth)), (smooth[:, 0], smooth[:, 1])), shape=(n, n))
    return connected_components(graph, directed=False)[1]


def patches_at(n: int, faces: np.ndarray, patch: np.ndarray) -> list[set[int]]:
    """Labels of the patches that meet at each of n vertices, from faces (f, 3) and their ``patch`` (f,)."""
    at = coo_matrix((np.ones(faces.size), (faces.ravel(), np.repeat(patch, 3))), shape=(n, patch.max() + 1)).tocsr()
    labels, start = at.indices.tolist(), at.indptr.tolist()
    return [set(labels[i:j]) for i, j in pairwise(start)]


def shells(surface: trimesh.Trimesh) -> list[np.ndarray]:
    """Indices of the faces of each connected component of a surface."""
    return trimesh.graph.connected_components(surface.face_adjacency, nodes=np.arange(len(surface.faces)), min_len=1)


def enclosed_volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Signed volume within closed triangles; negative for the wall of a cavity."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)
