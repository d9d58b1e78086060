"""Derivatives at an element's corners against shape functions, and the transposes that scatter."""

import numpy as np
import pytest
import warp as wp

from simgen.fem.elements.element import TET_EDGES, barycentric_p2_gradient
from simgen.fem.elements.element_fields import (
    corner_gradients,
    corner_pressures,
    edge_gradient,
    scatter_gradients,
    scatter_pressures,
    without_mean,
)
from simgen.fem.precision import mat33

TET = np.array([[3, 0, 7, 5, 1, 9, 2, 8, 4, 6]], dtype=np.int32)  # nodes in no order
NODES = 10


@wp.kernel(enable_backward=False)
def gather_kernel(
    tetrahedra: wp.array2d(dtype=wp.int32),
    x: wp.array2d(dtype=wp.float64),
    gradients_out: wp.array(dtype=mat33),
    deviations_out: wp.array(dtype=mat33),
    pressures_out: wp.array(dtype=wp.vec4d),
):
    A, B, C, D = corner_gradients(tetrahedra, x, 0, 0)
    gradients_out[0] = A
    gradients_out[1] = B
    gradients_out[2] = C
    gradients_out[3] = D
    a, b, c, d = without_mean(A, B, C, D)
    deviations_out[0] = a
    deviations_out[1] = b
    deviations_out[2] = c
    deviations_out[3] = d
    pressures_out[0] = corner_pressures(tetrahedra, x, 30, 0, 0)


@wp.kernel(enable_backward=False)
def scatter_kernel(
    tetrahedra: wp.array2d(dtype=wp.int32),
    P: wp.array(dtype=mat33),
    p: wp.vec4d,
    x_out: wp.array2d(dtype=wp.float64),
):
    scatter_gradients(tetrahedra, P[0], P[1], P[2], P[3], 0, 0, x_out)
    scatter_pressures(tetrahedra, p, 30, 0, 0, x_out)


@wp.kernel(enable_backward=False)
def edge_kernel(shapes: wp.vec4f, edges: wp.array2d(dtype=wp.int32), out: wp.array(dtype=wp.vec3f)):
    k = wp.tid()
    out[k] = edge_gradient(shapes, edges[k, 0], edges[k, 1])


def by_xi(corner_shapes):
    """Derivatives (q, 10, 3) of the quadratic shape functions by xi."""
    gradient = barycentric_p2_gradient(corner_shapes, TET_EDGES)
    return gradient[:, :, 1:] - gradient[:, :, :1]


def gathered(tet, x):
    out = [wp.zeros(4, dtype=mat33, device="cpu") for _ in range(2)] + [wp.zeros(1, dtype=wp.vec4d, device="cpu")]
    inputs = [wp.array(tet, dtype=wp.int32, device="cpu"), wp.array(x[:, None], dtype=wp.float64, device="cpu")]
    wp.launch(gather_kernel, dim=1, inputs=inputs, outputs=out, device="cpu")
    return [each.numpy() for each in out]


def test_corner_gradients_are_those_of_the_shape_functions():
    x = np.random.default_rng(0).normal(size=4 * NODES)
    u = x[: 3 * NODES].reshape(-1, 3)[TET[0]]
    gradients, deviations, pressures = gathered(TET, x)
    np.testing.assert_allclose(gradients, np.einsum("ai,qaj->qij", u, by_xi(np.eye(4))), atol=1e-13)
    np.testing.assert_allclose(deviations, gradients - gradients.mean(axis=0), atol=1e-13)
    np.testing.assert_array_equal(pressures[0], x[30 + TET[0, :4]])


def test_a_linear_element_has_one_gradient_and_no_pressure():
    x = np.random.default_rng(1).normal(size=4 * NODES)
    u = x[: 3 * NODES].reshape(-1, 3)[TET[0, :4]]
    gradients, deviations, pressures = gathered(TET[:, :4], x)
    np.testing.assert_allclose(gradients, np.tile((u[1:] - u[0]).T, (4, 1, 1)), atol=1e-15)
    assert not deviations.any() and not pressures.any()


@pytest.mark.parametrize("nodes", [4, 10])
def test_scattering_is_the_transpose_of_gathering(nodes):
    rng = np.random.default_rng(2)
    x, P, p = rng.normal(size=4 * NODES), rng.normal(size=(4, 3, 3)), rng.normal(size=4)
    gradients, _, pressures = gathered(TET[:, :nodes], x)
    forces = wp.zeros((4 * NODES, 1), dtype=wp.float64, device="cpu")
    inputs = [wp.array(TET[:, :nodes], dtype=wp.int32, device="cpu"), wp.array(P, dtype=mat33, device="cpu")]
    wp.launch(scatter_kernel, dim=1, inputs=[*inputs, wp.vec4d(*p)], outputs=[forces], device="cpu")
    work = np.sum(P * gradients) + p @ pressures[0]
    assert forces.numpy()[:, 0] @ x == pytest.approx(work, rel=1e-12)


def test_edge_gradients_are_those_of_the_shape_functions():
    shapes = np.array([0.1, 0.2, 0.3, 0.4])
    edges = np.vstack([np.repeat(np.arange(4), 2).reshape(4, 2), TET_EDGES])  # a corner is the edge from itself
    out = wp.zeros(10, dtype=wp.vec3f, device="cpu")
    inputs = [wp.vec4f(*shapes), wp.array(edges, dtype=wp.int32, device="cpu")]
    wp.launch(edge_kernel, dim=10, inputs=inputs, outputs=[out], device="cpu")
    np.testing.assert_allclose(out.numpy(), by_xi(shapes[None])[0], atol=1e-6)
