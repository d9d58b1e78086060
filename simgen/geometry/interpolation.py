"""Shape functions of ten-node tetrahedra, and interpolation of nodal fields at any point.

Local coordinates are barycentric, (l0, l1, l2, l3) with sum 1.
"""

import numpy as np
import trimesh
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

TET_EDGES = np.array([[0, 1], [1, 2], [2, 0], [0, 3], [1, 3], [2, 3]])
FACES = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
INSIDE = 1e-12  # distance to an element, relative to the mesh's size, at which a point counts as inside
STEPS = 12  # most Gauss-Newton steps to the nearest point of a curved element
CONVERGED = 1e-13  # change of barycentric coordinates that ends these steps
CANDIDATES = 6  # elements with the nearest centroids: they contain nearly all points inside


def shape_functions(barycentric: np.ndarray) -> np.ndarray:
    """The ten quadratic shape functions: (..., 4) -> (..., 10); corners l (2 l - 1), mid-edges 4 l_i l_j."""
    corner = barycentric * (2.0 * barycentric - 1.0)
    middle = 4.0 * barycentric[..., TET_EDGES[:, 0]] * barycentric[..., TET_EDGES[:, 1]]
    return np.concatenate([corner, middle], axis=-1)


def shape_gradients(barycentric: np.ndarray) -> np.ndarray:
    """Derivatives by l1, l2, l3 with l0 = 1 - l1 - l2 - l3: (..., 4) -> (..., 10, 3)."""
    by_l = np.zeros((*barycentric.shape[:-1], 10, 4))
    for i in range(4):
        by_l[..., i, i] = 4.0 * barycentric[..., i] - 1.0
    for e, (i, j) in enumerate(TET_EDGES):
        by_l[..., 4 + e, i] = 4.0 * barycentric[..., j]
        by_l[..., 4 + e, j] = 4.0 * barycentric[..., i]
    return by_l[..., 1:] - by_l[..., :1]


def geometry_jacobian(element_nodes: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
    """Derivative of position by (l1, l2, l3): nodes (..., 10, 3), coordinates (..., 4) -> (..., 3, 3)."""
    return np.einsum("...ni,...nj->...ij", element_nodes, shape_gradients(barycentric))


def _nearest_inside(element_nodes: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Barycentric coordinates (m, 4) of the point of each element (m, 10, 3) that is nearest to ``points`` (m, 3).

    A Gauss-Newton step replaces the element by the straight tetrahedron that is tangent to it at the last iterate, and
    takes the nearest point of that. Straight elements need one step.
    """
    barycentric = np.full((len(points), 4), 0.25)
    best, least = barycentric.copy(), np.full(len(points), np.inf)
    moving = np.arange(len(points))
    for _ in range(STEPS):
        now = barycentric[moving]
        reached = np.einsum("mn,mni->mi", shape_functions(now), element_nodes[moving])
        edges = np.swapaxes(geometry_jacobian(element_nodes[moving], now), 1, 2)  # (m, corner 1 to 3, xyz)
        first = reached - np.einsum("mk,mki->mi", now[:, 1:], edges)
        corners = np.concatenate([first[:, None], first[:, None] + edges], axis=1)
        barycentric[moving] = _nearest_in_straight(corners, points[moving])
        reached = np.einsum("mn,mni->mi", shape_functions(barycentric[moving]), element_nodes[moving])
        distance = np.linalg.norm(reached - points[moving], axis=1)
        nearer = distance < least[moving]
        best[moving[nearer]], least[moving[nearer]] = barycentric[moving[nearer]], distance[nearer]
        moving = moving[np.abs(barycentric[moving] - now).max(axis=1) > CONVERGED]
    return best


def _nearest_in_straight(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """As `_nearest_inside`, for straight tetrahedra with corners (m, 4, 3)."""
    edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
    volume, size = np.linalg.det(edges), np.abs(edges).max(axis=(1, 2))
    flat = np.abs(volume) < 1e-9 * size**3
    edges[flat] = np.eye(3)
    inner = np.linalg.solve(edges, (points - corners[:, 0])[..., None])[..., 0]
    barycentric = np.concatenate([1.0 - inner.sum(axis=1, keepdims=True), inner], axis=1)
    outside = np.flatnonzero(flat | (barycentric < 0.0).any(axis=1))
    if not len(outside):
        return barycentric
    # Scaled to the size of the tetrahedron, because trimesh has absolute tolerances.
    middle, size = corners[outside].mean(axis=1), size[outside, None]
    corners, points = (corners[outside] - middle[:, None]) / size[..., None], (points[outside] - middle) / size
    least = np.full(len(outside), np.inf)
    for face in FACES:
        foot = trimesh.triangles.closest_point(corners[:, face], points)
        distance = np.linalg.norm(foot - points, axis=1)
        nearer = distance < least
        least[nearer] = distance[nearer]
        place = np.zeros((np.count_nonzero(nearer), 4))
        place[:, face] = trimesh.triangles.points_to_barycentric(corners[nearer][:, face], foot[nearer])
        barycentric[outside[nearer]] = place
    barycentric[outside] = np.clip(barycentric[outside], 0.0, 1.0)
    barycentric[outside] /= barycentric[outside].sum(axis=1, keepdims=True)
    return barycentric


def locate(nodes: np.ndarray, tetrahedra: np.ndarray, points: np.ndarray):
    """Find the point of a mesh, nodes (n, 3) and tetrahedra (e, 10), nearest to each of ``points`` (m, 3).

    Returns its element (m,), its barycentric coordinates (m, 4) and its distance (m,) in the unit of the nodes. The
    distance is zero (to rounding) for points inside. A point on a face has one of the face's two elements.
    """
    search = _Search(nodes[tetrahedra], points)
    inside = INSIDE * np.ptp(nodes)
    few = min(CANDIDATES, len(tetrahedra))
    _, candidates = cKDTree(search.element_nodes[:, :4].mean(axis=1)).query(points, k=range(1, few + 1))
    for column in candidates.T:
        outside = np.flatnonzero(search.distance > inside)
        search.compare(outside, column[outside])
    # Beside a large element the centroids of many small ones may be nearer. So a point outside tries every element
    # whose bounding box is nearer than the best candidate.
    outside = np.flatnonzero(search.distance > inside)
    search.compare(*_pairs_in_reach(search.element_nodes, points, outside, search.distance[outside]))
    return search.element, search.barycentric, search.distance


class _Search:
    """The nearest point of a mesh to each of m points, among the elements that were compared so far.

    element (m,), barycentric (m, 4), distance (m,): of the nearest point; distances are inf before the first comparison
    """

    def __init__(self, element_nodes: np.ndarray, points: np.ndarray):
        self.element_nodes, self.points = element_nodes, points
        self.element = np.zeros(len(points), dtype=np.int64)
        self.barycentric = np.zeros((len(points), 4))
        self.distance = np.full(len(points), np.inf)

    def compare(self, point: np.ndarray, element: np.ndarray):
        """Compare pairs of a point and an element, given by numbers (pair,) each."""
        element_nodes, target = self.element_nodes[element], self.points[point]
        barycentric = _nearest_inside(element_nodes, target)
        reached = np.einsum("mn,mni->mi", shape_functions(barycentric), element_nodes)
        distance = np.linalg.norm(reached - target, axis=1)
        order = np.lexsort([distance, point])
        best = order[np.unique(point[order], return_index=True)[1]]
        best = best[distance[best] < self.distance[point[best]]]
        at = point[best]
        self.element[at], self.barycentric[at], self.distance[at] = element[best], barycentric[best], distance[best]


def _pairs_in_reach(
    element_nodes: np.ndarray, points: np.ndarray, chosen: np.ndarray, reach: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (pair,) of a chosen point and an element whose bounding box is nearer than the point's ``reach``.

    chosen, reach (c,): numbers of points, and distances.
    """
    least, most = element_nodes.min(axis=1), element_nodes.max(axis=1)
    middle, radius = 0.5 * (least + most), 0.5 * np.linalg.norm(most - least, axis=1)
    near = cKDTree(middle).query_ball_point(points[chosen], reach + radius.max(), return_sorted=False)
    point = np.repeat(np.arange(len(chosen)), [len(each) for each in near])
    element = np.concatenate([np.zeros(0, dtype=np.int64), *near]).astype(np.int64)
    position = points[chosen[point]]
    gap = np.maximum(np.maximum(least[element] - position, position - most[element]), 0.0)
    in_reach = np.linalg.norm(gap, axis=1) < reach[point]
    return chosen[point[in_reach]], element[in_reach]


def interpolation_matrix(simulation, points: np.ndarray) -> csr_matrix:
    """Matrix (p, n) of shape functions, from nodal values of a `SimulationMesh` to values at points (p, 3), m.

    A point outside takes the value at the nearest point of the mesh; `locate` gives the distance.
    """
    element, barycentric, _ = locate(simulation.nodes, simulation.tetrahedra, np.asarray(points, dtype=float))
    rows = np.repeat(np.arange(len(points)), 10)
    columns = simulation.tetrahedra[element].ravel()
    values = shape_functions(barycentric).ravel()
    return csr_matrix((values, (rows, columns)), shape=(len(points), len(simulation.nodes)))
