"""Fine triangles on the curved faces of a solution, for whatever needs the surface between its nodes.

A point of a quadratic face moves with the six nodes of the face, as in the solution itself. So the triangles follow the
solution, not the chords between its nodes.
"""

import numpy as np
import scipy.sparse as sparse

EDGES = ((0, 1), (1, 2), (2, 0))  # corners of the edges of a face, in the order of its middle nodes


def subdivided_faces(faces: np.ndarray, n_nodes: int, divisions: int) -> tuple[sparse.csr_array, np.ndarray]:
    """Divide each edge of each face into ``divisions`` parts, and the face into ``divisions`` squared triangles.

    faces : (f, 6) nodes of quadratic faces, corners first, then the middles of the edges `EDGES`; or (f, 3) corners

    Returns a matrix (point, n_nodes), which gives the points from the nodes and any field at the points from the field
    at the nodes, and triangles (t, 3) of points, oriented like the faces. Neighbouring faces share the points of their
    common edge.
    """
    steps = np.array([(i, j) for i in range(divisions + 1) for j in range(divisions + 1 - i)])
    steps = np.column_stack([divisions - steps.sum(axis=1), steps])  # (p, 3), barycentric in parts of an edge
    number = {tuple(each): k for k, each in enumerate(steps.tolist())}
    upward = [[(a, b, c), (a - 1, b + 1, c), (a - 1, b, c + 1)] for a, b, c in steps.tolist() if a > 0]
    downward = [[(a, b, c), (a - 1, b, c + 1), (a, b - 1, c + 1)] for a, b, c in steps.tolist() if a > 0 and b > 0]
    local = np.array([[number[corner] for corner in each] for each in upward + downward])

    place, own = _shared_points(faces[:, :3], steps)
    weights = _shape_functions(steps / divisions, faces.shape[1] == 6)  # (p, nodes of a face)
    face, point = np.divmod(own, len(steps))
    rows = np.repeat(np.arange(len(own)), faces.shape[1])
    matrix = sparse.csr_array((weights[point].ravel(), (rows, faces[face].ravel())), shape=(len(own), n_nodes))
    matrix.eliminate_zeros()
    return matrix, place.reshape(len(faces), len(steps))[:, local].reshape(-1, 3).astype(np.int32)


def _shared_points(corners: np.ndarray, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Number (f p,) of each face's points when common ones count once, and an owner (n,) among the f p for each.

    A point is known by the corners that it depends on and its steps from them.
    """
    names = np.where(steps[None] > 0, corners[:, None, :], -1)  # (f, p, 3)
    order = np.argsort(names, axis=2)
    amounts = np.broadcast_to(steps, names.shape)
    key = np.concatenate([np.take_along_axis(each, order, axis=2) for each in (names, amounts)], axis=2)
    _, own, place = np.unique(key.reshape(-1, 6), axis=0, return_index=True, return_inverse=True)
    return place.ravel(), own


def _shape_functions(barycentric: np.ndarray, quadratic: bool) -> np.ndarray:
    """Shape functions of a face at points (p, 3): corners l (2 l - 1), middles 4 l_i l_j; or l alone."""
    if not quadratic:
        return barycentric
    middles = [4.0 * barycentric[:, i] * barycentric[:, j] for i, j in EDGES]
    return np.column_stack([barycentric * (2.0 * barycentric - 1.0), *middles])
