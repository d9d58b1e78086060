"""Elements that are kept open: energies, derivatives, and which elements get them."""

import numpy as np
import pytest
import warp as wp

from fem.elements.test_elasticity import SINGLE, action, body, residual
from simgen.fem import blocks
from simgen.fem.elements.element import P2P1
from simgen.fem.elements.stabilisation import FIRST, FLAT
from simgen.verification.validate.operator import rotation


def stabilised(weight: float = 16.0):
    """The body with this weight in half of its elements."""
    nodes, term = body(P2P1)
    weights = np.zeros(term.weight.shape, dtype=np.float32)
    weights[::2] = weight
    term.weight.assign(weights)
    return nodes, term


def unknowns(term, u: np.ndarray) -> np.ndarray:
    return np.concatenate([u.ravel(), np.zeros(term.n_pressures)])


def on_device(x: np.ndarray):
    return wp.array(x.reshape(len(x), -1), dtype=wp.float64, device="cpu")


def test_tangent_against_finite_differences():
    _, term = stabilised()
    n = term.n_displacements + term.n_pressures
    rng = np.random.default_rng(0)
    x, v = 0.03 * rng.normal(size=n), rng.normal(size=n)
    exact, h = action(term, x, v), 1e-5
    difference = (residual(term, x + h * v)[0] - residual(term, x - h * v)[0])[:, 0] / (2 * h)
    assert np.linalg.norm(difference - exact) < SINGLE * np.linalg.norm(exact)


def test_a_quadratic_field_has_the_energy_of_its_strain_gradient():
    """u_x = c x^2 with J far from what the volumetric part sees: both parts against their integrals."""
    nodes, term = body(P2P1)
    c, weight = 1e-4, 8.0
    x = unknowns(term, np.column_stack([c * nodes[:, 0] ** 2, *np.zeros((2, len(nodes)))]))
    plain = x @ residual(term, x)[0][:, 0]
    term.weight.fill_(weight)
    more = x @ residual(term, x)[0][:, 0] - plain  # twice the energy of what is quadratic in u
    corners = nodes[term.host_tetrahedra[:, :4]]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6.0
    gradients = 2.0 * c * corners[:, :, 0]
    spread = ((gradients - gradients.mean(axis=1, keepdims=True)) ** 2).mean(axis=1)
    mean_square = gradients.mean(axis=1) ** 2 + spread / 5.0  # of a linear function over a tetrahedron
    expected = term.material.mu * (weight / 16.0 * volumes @ spread + weight * volumes @ mean_square)
    assert more == pytest.approx(expected, rel=2e-3)  # J - 1 is not quite du/dx


def test_uniform_strains_and_rotations_do_no_work_on_the_strain_gradient():
    nodes, term = stabilised()
    F = rotation(np.array([0.0, 0.6, 0.8]), 0.7)  # J = 1, so that the volumetric part rests as well
    x = unknowns(term, nodes @ (F - np.eye(3)).T)
    assert np.abs(residual(term, x)[0]).max() < 1e-12


def test_blocks_and_diagonal_are_those_of_the_tangent():
    nodes, term = stabilised()
    n = term.n_displacements + term.n_pressures
    x = 0.03 * np.random.default_rng(2).normal(size=n)
    made = blocks.zeros(len(nodes), 1, "cpu")
    term.linearize(on_device(x))
    term.diagonal(made)
    diagonal = blocks.of_environment(made, 0)
    for node in (0, len(nodes) // 2, len(nodes) - 1):  # a corner, and middles of edges
        column = action(term, x, np.eye(n)[3 * node], reduced=True)[3 * node : 3 * node + 3]
        np.testing.assert_allclose(diagonal[node, :, 0], column, rtol=0, atol=SINGLE * np.abs(column).max())


def folded(nodes: np.ndarray, term, share: float) -> np.ndarray:
    """u = -x^2 share / 2.2 along x: det F = 1 - share x / 1.1, with x up to 1.5 or so."""
    u = np.zeros((len(nodes), 3))
    u[:, 0] = -share * nodes[:, 0] ** 2 / 2.2
    return unknowns(term, u)


def test_elements_that_are_inside_out_get_twice_as_much_each_time():
    nodes, term = body(P2P1)
    x = on_device(folded(nodes, term, 1.0))
    wrong = term.bound_det_F(x).read()[1][0]
    for times in range(3):
        assert term.stabilise(x).read()[0] == wrong == term.stabilised_elements().read()[0]
        assert term.weight.numpy().max() == FIRST * 2.0**times
    term.reinforce(term.active)
    assert term.weight.numpy().max() == FIRST * 16.0
    term.forget(term.active)
    assert term.stabilised_elements().read()[0] == 0


def test_elements_that_are_nearly_flat_are_stabilised_before_they_turn():
    nodes, term = body(P2P1)
    largest, flat = nodes[:, 0].max(), float(FLAT)
    for least, first in ((1.1 * flat, 0.0), (0.8 * flat, FIRST), (0.4 * flat, 2.0 * FIRST)):
        term.forget(term.active)
        term.expect(on_device(folded(nodes, term, (1.0 - least) * 1.1 / largest)))
        assert term.weight.numpy().max() == first
    weights = term.weight.numpy().copy()
    term.expect(on_device(unknowns(term, np.zeros_like(nodes))))  # none falls during a press
    np.testing.assert_array_equal(term.weight.numpy(), weights)
