"""Fine triangles on curved faces: exact for quadratic surfaces, joined, and turned like the faces."""

import numpy as np
import pytest
import trimesh

from simgen.geometry.subdivided_faces import EDGES, subdivided_faces


def quadratic_sphere() -> tuple[np.ndarray, np.ndarray]:
    """Nodes (n, 3) on the unit sphere and six-node faces (80, 6), outward."""
    ball = trimesh.creation.icosphere(subdivisions=1)
    nodes, number, faces = list(np.asarray(ball.vertices)), {}, []
    for face in np.asarray(ball.faces).tolist():
        middles = []
        for i, j in EDGES:
            edge = tuple(sorted((face[i], face[j])))
            if edge not in number:
                middle = nodes[edge[0]] + nodes[edge[1]]
                number[edge] = len(nodes)
                nodes.append(middle / np.linalg.norm(middle))
            middles.append(number[edge])
        faces.append(face + middles)
    return np.array(nodes), np.array(faces)


def test_a_quadratic_surface_is_met_exactly_at_every_point():
    """x y and x^2 over a plane of six-node faces: the points lie on the surface, whatever their number."""
    flat = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.5, 0.0], [1.0, 0.5], [0.5, 0.5], [0.5, 1.0],
                     [0.0, 0.5]])  # fmt: skip
    faces = np.array([[0, 1, 2, 4, 5, 6], [0, 2, 3, 6, 7, 8]])
    for divisions in (1, 3, 4):
        matrix, triangles = subdivided_faces(faces, len(flat), divisions)
        x, y = (matrix @ flat).T
        np.testing.assert_allclose(matrix @ (flat[:, 0] * flat[:, 1] + flat[:, 0] ** 2), x * y + x * x, atol=1e-15)
        assert len(x) == (divisions + 1) ** 2 and len(triangles) == 2 * divisions**2
        assert triangles.dtype == np.int32


@pytest.mark.parametrize("divisions", [1, 2, 5])
def test_faces_stay_joined_and_face_outwards(divisions):
    nodes, faces = quadratic_sphere()
    matrix, triangles = subdivided_faces(faces, len(nodes), divisions)
    fine = trimesh.Trimesh(matrix @ nodes, triangles, process=False)
    assert fine.is_watertight and fine.volume > 0.0
    assert len(triangles) == 80 * divisions**2


def test_finer_triangles_approach_the_curved_faces_by_the_square_of_their_size():
    nodes, faces = quadratic_sphere()
    areas = [trimesh.Trimesh(matrix @ nodes, triangles, process=False).area
             for matrix, triangles in (subdivided_faces(faces, len(nodes), count) for count in (4, 8, 16))]  # fmt: skip
    assert (areas[2] - areas[1]) / (areas[1] - areas[0]) == pytest.approx(0.25, abs=0.02)


def test_flat_faces_are_divided_evenly():
    matrix, triangles = subdivided_faces(np.array([[0, 1, 2]]), 3, 4)
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    a, b, c = (matrix @ corners)[triangles].swapaxes(0, 1)
    (bx, by), (cx, cy) = (b - a).T, (c - a).T
    np.testing.assert_allclose(bx * cy - by * cx, 1.0 / 16.0)
