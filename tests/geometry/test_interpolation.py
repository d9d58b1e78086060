"""Quadratic interpolation: exact on straight elements, a partition of unity, nearest point outside."""

import numpy as np
import pytest

from simgen.geometry.interpolation import (
    TET_EDGES,
    geometry_jacobian,
    interpolation_matrix,
    locate,
    shape_functions,
    shape_gradients,
)
from simgen.geometry.tetrahedra import SimulationMesh, signed_volumes, sizing_grid


def straight_mesh(vertices, tetrahedra) -> SimulationMesh:
    edges, number = np.unique(np.sort(tetrahedra[:, TET_EDGES].reshape(-1, 2), axis=1), axis=0, return_inverse=True)
    nodes = np.concatenate([vertices, vertices[edges].mean(axis=1)])
    ten = np.concatenate([tetrahedra, len(vertices) + number.reshape(-1, 6)], axis=1)
    none = np.zeros((0, 6), dtype=np.int32)
    return SimulationMesh(nodes, len(vertices), ten, np.zeros(len(nodes), bool), none, none, "")


@pytest.fixture(scope="module")
def box() -> SimulationMesh:
    vertices, tetrahedra = sizing_grid(np.zeros(3), np.array([3.0, 2.0, 1.0]), 0.5)
    inner = ((vertices > 0) & (vertices < [3.0, 2.0, 1.0])).all(axis=1)
    vertices[inner] += np.random.default_rng(0).uniform(-0.08, 0.08, (inner.sum(), 3))
    assert signed_volumes(vertices, tetrahedra).min() > 0
    return straight_mesh(vertices * 1e-3, tetrahedra)


def test_quadratic_fields_are_exact_on_straight_elements(box):
    rng = np.random.default_rng(2)
    points = rng.uniform(0.0, 1.0, (500, 3)) * np.array([3.0, 2.0, 1.0]) * 1e-3
    a, b, c = rng.normal(size=(3, 3)), rng.normal(size=3), rng.normal()

    def field(x):
        x = x * 1e3
        return np.einsum("ni,ij,nj->n", x, a, x) + x @ b + c

    matrix = interpolation_matrix(box, points)
    np.testing.assert_allclose(matrix @ field(box.nodes), field(points), rtol=0, atol=1e-11)
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0, atol=1e-13)


def test_points_outside_go_to_the_nearest_place(box):
    """In a box the nearest place is the point clamped to it."""
    size = np.array([3.0, 2.0, 1.0])
    points = np.random.default_rng(4).uniform(-1.0, size + 1.0, (2000, 3))
    _, barycentric, distance = locate(box.nodes, box.tetrahedra, points * 1e-3)
    assert barycentric.min() >= 0.0
    foot = np.clip(points, 0.0, size)
    np.testing.assert_allclose(distance * 1e3, np.linalg.norm(points - foot, axis=1), atol=1e-11)
    np.testing.assert_allclose(interpolation_matrix(box, points * 1e-3) @ box.nodes * 1e3, foot, atol=1e-11)


def test_points_outside_a_curved_mesh_go_to_the_nearest_place(box):
    """The box is bent along a circle: the nearest place on its outer face is on the line to the circle's centre."""
    x, y, z = (box.nodes * 1e3).T
    radius = 8.0 + z
    bent = np.stack([radius * np.sin(x / 8.0), y, radius * np.cos(x / 8.0)], axis=1)
    angle, height = np.random.default_rng(5).uniform([0.02, 0.2], [0.35, 1.8], (200, 2)).T
    across = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=1)
    points = 9.3 * across + np.stack([np.zeros_like(height), height, np.zeros_like(height)], axis=1)
    _, _, distance = locate(bent, box.tetrahedra, points)
    np.testing.assert_allclose(distance, 0.3, atol=2e-4)  # chord error of a parabola over 0.56 mm of the arc
    inside = points - 0.6 * across
    element, barycentric, distance = locate(bent, box.tetrahedra, inside)
    assert distance.max() < 1e-12
    reached = np.einsum("mn,mni->mi", shape_functions(barycentric), bent[box.tetrahedra[element]])
    np.testing.assert_allclose(reached, inside, atol=1e-12)


def test_a_point_in_a_large_element_beside_many_small_ones_is_found():
    vertices, tetrahedra = sizing_grid(np.zeros(3), np.ones(3), 0.2)
    large = np.array([[-0.1, -0.1, -1e-9], [9.0, 0.0, -1e-9], [0.0, 9.0, -1e-9], [0.0, 0.0, -9.0]])
    large = straight_mesh(
        np.concatenate([vertices, large]), np.vstack([tetrahedra, len(vertices) + np.array([[0, 2, 1, 3]])])
    )
    points = np.array([[0.5, 0.5, -0.01], [0.0, 0.0, -0.1], [0.9, 0.1, -0.05]])
    element, _, distance = locate(large.nodes, large.tetrahedra, points)
    assert (element == len(tetrahedra)).all() and distance.max() < 1e-14


def test_shape_functions_are_one_at_their_own_node():
    corners = np.eye(4)
    nodes = np.concatenate([corners, corners[TET_EDGES].mean(axis=1)])
    np.testing.assert_allclose(shape_functions(nodes), np.eye(10), atol=1e-15)


def test_gradients_match_differences_and_the_jacobian_of_a_straight_element_is_constant():
    rng = np.random.default_rng(3)
    barycentric = rng.dirichlet(np.ones(4), 20)
    step = 1e-6
    for k in range(3):
        move = np.zeros(4)
        move[[0, k + 1]] = [-step, step]
        difference = (shape_functions(barycentric + move) - shape_functions(barycentric - move)) / (2 * step)
        np.testing.assert_allclose(shape_gradients(barycentric)[..., k], difference, atol=1e-8)
    corners = rng.normal(size=(4, 3))
    nodes = np.concatenate([corners, corners[TET_EDGES].mean(axis=1)])
    expected = (corners[1:] - corners[0]).T
    for jacobian in geometry_jacobian(np.broadcast_to(nodes, (20, 10, 3)), barycentric):
        np.testing.assert_allclose(jacobian, expected, atol=1e-12)
