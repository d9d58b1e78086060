"""Values of a quadratic field anywhere in a curved tetrahedral mesh.

Local coordinates are barycentric, (l0, l1, l2, l3) with sum 1.
"""

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

TET_EDGES = np.array([[0, 1], [1, 2], [2, 0], [0, 3], [1, 3], [2, 3]])
INSIDE = 1e-12  # of the mesh's size: a point this near to an element's point is in the element
FEW = 6  # elements with the nearest centroids: they hold nearly all points inside


def shape_functions(barycentric: np.ndarray) -> np.ndarray:
    """The ten quadratic shape functions: (..., 4) -> (..., 10); corners l (2 l - 1), middles 4 l_i l_j."""
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


def _invert(element_nodes: np.ndarray, points: np.ndarray, steps: int = 6) -> np.ndarray:
    """Barycentric coordinates of points (m, 3) in elements (m, 10, 3), inside or not: Newton's method."""
    barycentric = np.full((len(points), 4), 0.25)
    for _ in range(steps):
        miss = points - np.einsum("mn,mni->mi", shape_functions(barycentric), element_nodes)
        jacobian = geometry_jacobian(element_nodes, barycentric)
        singular = np.abs(np.linalg.det(jacobian)) < 1e-30
        jacobian[singular] = np.eye(3)
        step = np.linalg.solve(jacobian, miss[..., None])[..., 0]
        step[singular] = 0.0
        # Far outside its element the quadratic map folds over: such a point only has to stay recognisably
        # outside.
        step /= np.maximum(1.0, np.abs(step).max(axis=1, keepdims=True))
        barycentric[:, 1:] += step
        barycentric[:, 0] = 1.0 - barycentric[:, 1:].sum(axis=1)
    return barycentric


def _to_simplex(barycentric: np.ndarray) -> np.ndarray:
    """Closest barycentric coordinates with no negative entry (Duchi et al., ICML 2008, fig. 1)."""
    ordered = -np.sort(-barycentric, axis=-1)
    excess = (np.cumsum(ordered, axis=-1) - 1.0) / np.arange(1, 5)
    last = (ordered > excess).sum(axis=-1, keepdims=True) - 1
    return np.maximum(barycentric - np.take_along_axis(excess, last, axis=-1), 0.0)


def locate(nodes: np.ndarray, tetrahedra: np.ndarray, points: np.ndarray):
    """Element (m,), barycentric coordinates (m, 4) and distance (m,) of the mesh's point nearest each point.

    The distance is zero (to rounding) for points inside; points outside are moved to the boundary of an
    element, and the distance says by how much, in the unit of the nodes.
    """
    element_nodes = nodes[tetrahedra]
    few = min(FEW, len(tetrahedra))
    _, near = cKDTree(element_nodes[:, :4].mean(axis=1)).query(points, k=range(1, few + 1))
    point = np.repeat(np.arange(len(points)), few)
    element, barycentric, distance = _nearest(element_nodes, points, point, near.ravel())
    # Beside a large element the centroids of many small ones may be nearer. What is nearer has a nearer box, too.
    least, most = element_nodes.min(axis=1), element_nodes.max(axis=1)
    pairs = [np.zeros((2, 0), dtype=np.int64)]
    for i in np.flatnonzero(distance > INSIDE * np.ptp(nodes)):
        gap = np.maximum(np.maximum(least - points[i], points[i] - most), 0.0)
        near = np.flatnonzero((gap * gap).sum(axis=1) < distance[i] ** 2)
        near = np.append(near, element[i])
        pairs.append(np.stack([np.full_like(near, i), near]))
    point, near = np.hstack(pairs)
    again = np.unique(point)
    element[again], barycentric[again], distance[again] = _nearest(element_nodes, points, point, near)
    return element, barycentric, distance


def _nearest(element_nodes, points, point, element) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The best of the pairs of a ``point`` and an ``element`` (pairs,), for each point of them, as by `locate`."""
    target = points[point]
    barycentric = _to_simplex(_invert(element_nodes[element], target))
    reached = np.einsum("mn,mni->mi", shape_functions(barycentric), element_nodes[element])
    distance = np.linalg.norm(reached - target, axis=1)
    order = np.lexsort([distance, point])
    best = order[np.unique(point[order], return_index=True)[1]]
    return element[best], barycentric[best], distance[best]


def interpolation_matrix(simulation, points: np.ndarray) -> csr_matrix:
    """Quadratic shape functions as a matrix (p, n): nodal values of a `SimulationMesh` to points (p, 3), m.

    Points outside the mesh get the value of the nearest element; `locate` says how far they had to be moved.
    """
    element, barycentric, _ = locate(simulation.nodes, simulation.tetrahedra, np.asarray(points, dtype=float))
    rows = np.repeat(np.arange(len(points)), 10)
    columns = simulation.tetrahedra[element].ravel()
    values = shape_functions(barycentric).ravel()
    return csr_matrix((values, (rows, columns)), shape=(len(points), len(simulation.nodes)))
