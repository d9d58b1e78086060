"""Queries on triangulated surfaces: exact closest points, pieces near a place, smooth patches between sharp edges."""

import numpy as np
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

CREASE_DEG = (
    40.0  # a fillet meshed with three facets per quarter turn (30 deg) is still smooth, a chamfer (45) is not
)


class ClosestPoint:
    """Exact closest points on a set of triangles, by a tree over the centroids of their pieces.

    Large triangles are split first, so that a centroid is near every point of its piece.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray):
        longest = np.ptp(vertices[faces].reshape(-1, 3), axis=0).max() / 25.0
        pieces, piece_faces, self.owner = trimesh.remesh.subdivide_to_size(
            vertices, faces, longest, max_iter=60, return_index=True
        )
        self.scale = (
            1.0 / longest
        )  # trimesh compares products of lengths with absolute tolerances: keep them near 1
        self.triangles = pieces[piece_faces] * self.scale
        centroids = self.triangles.mean(axis=1)
        self.reach = np.linalg.norm(self.triangles - centroids[:, None], axis=2).max()
        self.tree = cKDTree(centroids)

    def __call__(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points (n, 3) -> closest points (n, 3), distances (n,), indices of the faces (n,)."""
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
            # A triangle that was not looked at lies at least (distance of its centroid - reach) away.
            sure = (gap[row, best] <= away[:, -1] - self.reach) | (k == len(self.triangles))
            todo = todo[~sure]
            k = min(4 * k, len(self.triangles))
        return closest / self.scale, distance / self.scale, self.owner[piece]


class FinePieces:
    """Triangles (f, 3, 3) that are subdivided where a caller looks at them, and nowhere else.

    So memory and time depend on how many pieces the ball holds, not on how many the whole surface would have.
    """

    def __init__(self, triangles: np.ndarray):
        self.measured = _measured(triangles)
        _, centroids, sizes, _ = self.measured
        self.reach = sizes.max()
        self.tree = cKDTree(centroids)

    def near(
        self, centre: np.ndarray, radius: float, longest: float, among: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Pieces (p, 3, 3) that may reach into a ball, and the triangle (p,) to which each belongs.

        A piece with an edge above ``longest`` is split into four at the middles of its edges. ``among`` (f,) bool: the
        triangles that count, all by default.
        """
        owner = np.array(self.tree.query_ball_point(centre, radius + self.reach), dtype=np.int64)
        owner = owner if among is None else owner[among[owner]]
        pieces, centroids, sizes, edges = (each[owner] for each in self.measured)
        found, owners = [np.empty((0, 3, 3))], [np.empty(0, dtype=np.int64)]
        while len(pieces):
            close = np.linalg.norm(centroids - centre, axis=1) <= radius + sizes
            short = edges <= longest
            found.append(pieces[close & short])
            owners.append(owner[close & short])
            owner = np.repeat(owner[close & ~short], 4)
            pieces, centroids, sizes, edges = _measured(_quarters(pieces[close & ~short]))
        return np.concatenate(found), np.concatenate(owners)


def _measured(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Triangles (t, 3, 3), their centroids (t, 3), how far their corners lie from these (t,), longest edges (t,)."""
    centroids = triangles.mean(axis=1)
    sizes = np.linalg.norm(triangles - centroids[:, None], axis=2).max(axis=1)
    edges = np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2).max(axis=1)
    return triangles, centroids, sizes, edges


def _quarters(triangles: np.ndarray) -> np.ndarray:
    """The four triangles (4 t, 3, 3) between the corners and the middles of the edges of each (t, 3, 3)."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    quarters = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
    return np.array(quarters).transpose(2, 0, 1, 3).reshape(-1, 3, 3)  # those of one triangle side by side


def smooth_patches(
    surface: trimesh.Trimesh, region: np.ndarray | None = None, crease_deg: float = CREASE_DEG
) -> np.ndarray:
    """Label (f,) of each face's smooth patch; patches meet at edges sharper than ``crease_deg``.

    With labels ``region`` (f,), also where those differ.
    """
    joined = surface.face_adjacency_angles < np.radians(crease_deg)
    if region is not None:
        joined &= region[surface.face_adjacency[:, 0]] == region[surface.face_adjacency[:, 1]]
    smooth = surface.face_adjacency[joined]
    n = len(surface.faces)
    graph = coo_matrix((np.ones(len(smooth)), (smooth[:, 0], smooth[:, 1])), shape=(n, n))
    return connected_components(graph, directed=False)[1]


def patches_at(n: int, faces: np.ndarray, patch: np.ndarray) -> list[set[int]]:
    """Labels (f,) of the faces (f, 3) that meet at each of n vertices: more than one on a crease."""
    meeting = [set() for _ in range(n)]
    for corner, label in zip(faces.ravel(), np.repeat(patch, 3), strict=True):
        meeting[corner].add(int(label))
    return meeting


def shells(surface: trimesh.Trimesh) -> list[np.ndarray]:
    """Face indices of each connected component of a surface."""
    return trimesh.graph.connected_components(
        surface.face_adjacency, nodes=np.arange(len(surface.faces)), min_len=1
    )


def enclosed_volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Signed volume within closed triangles; negative for the wall of a cavity, whose normals point inwards.
    """
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)
