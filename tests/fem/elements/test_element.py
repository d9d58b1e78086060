from math import factorial

import numpy as np
import pytest

from simgen.fem.elements.element import (
    P1,
    P2P1,
    TET_EDGES,
    TRIANGLE_EDGES,
    barycentric_p2,
    barycentric_p2_gradient,
    face_geometry,
    tet_geometry,
    tet_rule,
    triangle_rule,
)
from tests.fem.box import box, top


@pytest.mark.parametrize(("points", "degree"), [(1, 1), (4, 2), (8, 3), (14, 5)])
def test_tet_rules_integrate_their_degree_and_no_more(points, degree):
    x, w = tet_rule(points)
    assert len(x) == points and (w > 0).all()
    error = np.zeros(degree + 2)
    for e in np.ndindex(degree + 2, degree + 2, degree + 2):
        if sum(e) <= degree + 1:
            exact = 6.0 * np.prod([factorial(k) for k in e]) / factorial(sum(e) + 3)
            error[sum(e)] = max(error[sum(e)], abs(w @ np.prod(x[:, :3] ** np.array(e), axis=1) - exact))
    assert error[: degree + 1].max() < 1e-15  # rounding
    assert error[degree + 1] > 1e-6


@pytest.mark.parametrize("points, degree", [(6, 4), (12, 6)])
def test_triangle_rule_integrates_its_degree_and_no_more(points, degree):
    x, w = triangle_rule(points)
    assert x.shape == (points, 3) and w.min() > 0.0 and x.min() > 0.0
    error = np.zeros(degree + 2)
    for i, j in np.ndindex(degree + 2, degree + 2):
        if i + j <= degree + 1:
            exact = 2.0 * factorial(i) * factorial(j) / factorial(i + j + 2)
            error[i + j] = max(error[i + j], abs(w @ (x[:, 0] ** i * x[:, 1] ** j) - exact))
    assert error[: degree + 1].max() < 2e-15  # the digits of the published points
    assert error[degree + 1] > 1e-6


@pytest.mark.parametrize("edges", [TET_EDGES, TRIANGLE_EDGES])
def test_quadratic_shapes_sum_to_one_and_match_their_gradient(edges):
    n = edges.max() + 1
    x = np.random.default_rng(0).dirichlet(np.ones(n), size=5)
    np.testing.assert_allclose(barycentric_p2(x, edges).sum(axis=1), 1.0, atol=1e-15)
    gradient, h = barycentric_p2_gradient(x, edges), 1e-6
    for i in range(n):
        step = h * np.eye(n)[i]
        difference = (barycentric_p2(x + step, edges) - barycentric_p2(x - step, edges)) / (2 * h)
        np.testing.assert_allclose(gradient[:, :, i], difference, atol=1e-9)  # rounding / h


@pytest.mark.parametrize("element", [P1, P2P1])
def test_volume_area_and_a_linear_gradient_are_exact(element):
    nodes, tets, _, faces = box()
    geometry = tet_geometry(element, nodes, tets)
    assert geometry.volumes.sum() == pytest.approx(6 * 4 * 6, rel=1e-14)
    assert face_geometry(element, nodes, top(nodes, faces)).areas.sum() == pytest.approx(36.0, rel=1e-14)
    A = np.random.default_rng(1).normal(size=(3, 3))
    u = (nodes @ A.T)[tets[:, : element.nodes]]
    gradient = np.einsum("eai,eqaj->eqij", u, geometry.gradients)
    np.testing.assert_allclose(gradient, np.broadcast_to(A, gradient.shape), atol=1e-13)


def test_curved_elements_measure_a_ball():
    """Quadratic elements on a sphere: the volume error falls at least as h^4 when the mesh is refined."""
    error = []
    for n in (2, 4):
        nodes, tets, _, _ = box((n, n, n), (2.0, 2.0, 2.0))
        nodes = nodes - [0.0, 1.0, 0.0]
        radius = np.linalg.norm(nodes, axis=1)
        cube = np.abs(nodes).max(axis=1)
        mapped = nodes * (cube / np.maximum(radius, 1e-12))[:, None]
        error.append(abs(tet_geometry(P2P1, mapped, tets).volumes.sum() - 4.0 / 3.0 * np.pi))
    assert error[1] < error[0] / 8.0


@pytest.mark.parametrize("element", [P1, P2P1])
def test_the_inverse_of_the_geometry_map_of_bent_elements(element):
    nodes, tets, _, _ = box((2, 2, 2))
    nodes = nodes + 0.1 * np.random.default_rng(2).normal(size=nodes.shape)
    geometry = tet_geometry(element, nodes, tets)
    jacobian = np.einsum("eai,qaj->eqij", nodes[tets[:, : element.nodes]], geometry.local_gradients)
    np.testing.assert_allclose(geometry.inverse, np.linalg.inv(jacobian), rtol=1e-10, atol=1e-12)
    weights = tet_rule(element.quadrature_points)[1]
    np.testing.assert_allclose(geometry.volumes, np.linalg.det(jacobian) * weights / 6.0, rtol=1e-12)


def test_an_inverted_element_is_refused():
    nodes, tets, _, _ = box((1, 1, 1))
    with pytest.raises(ValueError, match=r"tetrahedron .* is inverted"):
        tet_geometry(P2P1, nodes, tets[:, [0, 2, 1, 3, 6, 5, 4, 7, 9, 8]])
