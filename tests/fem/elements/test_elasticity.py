"""The elastic body: its tangent against finite differences, equilibrium of homogeneous states, environments."""

import numpy as np
import pytest
import warp as wp

from simgen.fem.batch_arrays import ActiveEnvironments
from simgen.fem.elements.elasticity import Elasticity
from simgen.fem.elements.element import P1, P2P1
from simgen.fem.material import LAWS
from simgen.geometry.interpolation import shape_functions
from tests.fem.box import box, lattice

SINGLE = 2e-6  # relative: the tangent's rounding, 6e-8 for each of some hundred operations


CONSTANTS = {"neo_hookean": {}, "yeoh": {"c20": 0.05, "c30": 0.02}}


def body(element, n_env=1, law="neo_hookean"):
    nodes, tets, n_corners, _ = box()
    if element is P1:
        nodes = nodes[:n_corners]
    solid = LAWS[law].from_engineering(1.0, 0.499, 2.0 if element.pressures else None, **CONSTANTS[law])
    active = ActiveEnvironments(n_env, "cpu")
    return nodes, Elasticity(element, nodes, tets, n_corners, solid, "cpu", active)


def residual(term, x):
    x = np.ascontiguousarray(x.reshape(len(x), -1))
    r = wp.zeros(x.shape, dtype=wp.float64, device="cpu")
    least = wp.full(x.shape[1], np.inf, dtype=wp.float64, device="cpu")
    term.residual(wp.array(x, dtype=wp.float64, device="cpu"), r, least)
    return r.numpy(), least.numpy()


def action(term, x, v, reduced=False):
    out = wp.zeros((len(x), 1), dtype=wp.float32, device="cpu")
    term.linearize(wp.array(x.reshape(-1, 1), dtype=wp.float64, device="cpu"))
    term.tangent(wp.array(v.reshape(-1, 1), dtype=wp.float32, device="cpu"), out, reduced)
    return out.numpy()[:, 0]


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("element", [P1, P2P1])
def test_tangent_against_finite_differences(element, law):
    _, term = body(element, law=law)
    n = term.n_displacements + term.n_pressures
    rng = np.random.default_rng(0)
    x, v = 0.03 * rng.normal(size=n), rng.normal(size=n)
    exact = action(term, x, v)
    error = {}
    for h in (1e-2, 1e-3, 1e-5, 1e-13):
        difference = (residual(term, x + h * v)[0] - residual(term, x - h * v)[0])[:, 0] / (2 * h)
        error[h] = np.linalg.norm(difference - exact) / np.linalg.norm(exact)
    assert error[1e-2] / error[1e-3] == pytest.approx(100.0, rel=0.3)
    assert error[1e-5] < SINGLE < error[1e-13]


@pytest.mark.parametrize("law", LAWS)
def test_tangent_is_symmetric(law):
    _, term = body(P2P1, law=law)
    n = term.n_displacements + term.n_pressures
    x, v, w = np.random.default_rng(1).normal(size=(3, n)) * np.array([[0.03], [1.0], [1.0]])
    assert w @ action(term, x, v) == pytest.approx(v @ action(term, x, w), rel=SINGLE)


@pytest.mark.parametrize("element", [P1, P2P1])
def test_affine_deformation_is_in_equilibrium(element):
    """The Dirichlet patch test: a homogeneous state leaves no force on interior nodes."""
    nodes, term = body(element)
    F = np.eye(3) + np.array([[0.2, 0.1, 0.0], [0.0, -0.1, 0.2], [0.1, 0.0, 0.15]])
    pressure = (term.material.lam - term.material.gamma) * (np.linalg.det(F) - 1.0)
    x = np.concatenate([(nodes @ (F - np.eye(3)).T).ravel(), np.full(term.n_pressures, pressure)])
    r, least = residual(term, x)
    half = np.array([3.0, 2.0, 3.0])
    interior = (np.abs(nodes - [0.0, 2.0, 0.0]) < half - 1e-9).all(axis=1)
    forces = r[: term.n_displacements, 0].reshape(-1, 3)
    assert interior.sum() > 3
    assert np.abs(forces[interior]).max() < 1e-12 * np.abs(forces).max()
    assert np.abs(r[term.n_displacements :]).max(initial=0.0) < 1e-12
    assert least[0] == pytest.approx(np.linalg.det(F), rel=1e-12)


def test_environments_are_independent():
    _, term = body(P2P1, n_env=3)
    n = term.n_displacements + term.n_pressures
    x = 0.03 * np.random.default_rng(3).normal(size=(n, 3))
    together = residual(term, x)[0]
    _, single = body(P2P1)
    for env in range(3):
        np.testing.assert_array_equal(together[:, env], residual(single, x[:, env])[0][:, 0])
    term.active.choose(np.array([1, 0, 1]) == 1)
    assert np.abs(residual(term, x)[0][:, 1]).max() == 0.0


def test_elements_that_are_inside_out_in_part_are_counted():
    """u = -x^2 / 2.2 along x: det F = 1 - x / 1.1, which a quadratic element has exactly."""
    nodes, term = body(P2P1, n_env=2)
    bent = np.zeros((term.n_displacements + term.n_pressures, 2))
    bent[: term.n_displacements : 3, 1] = -(nodes[:, 0] ** 2) / 2.2
    least, count = term.bound_det_F(wp.array(bent, dtype=wp.float64, device="cpu")).read()
    x = np.einsum("qn,en->eq", shape_functions(lattice(3)), nodes[term.host_tetrahedra][:, :, 0])
    assert count[0] == 0
    assert 0 < count[1] == (x > 1.1).any(axis=1).sum() < len(x)
    np.testing.assert_allclose(least, [1.0, 1.0 - x.max() / 1.1], atol=1e-12)
