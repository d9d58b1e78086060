"""The parts that the cases are made of, and that a wrong solver does not pass them."""

import math

import numpy as np
import pytest

from simgen.fem.batch_arrays import ActiveEnvironments
from simgen.fem.elements.elasticity import Elasticity
from simgen.fem.elements.element import P2P1, face_geometry
from simgen.fem.material.neo_hookean import NeoHookean
from simgen.verification.validate import equilibrium, exact, operator, order
from simgen.verification.validate.case import Context
from simgen.verification.validate.inflation import compressible, incompressible
from simgen.verification.validate.law import Law
from simgen.verification.validate.meshes import box, perturbed, top

CONTEXT = Context("cpu", None, None, None)


def test_stress_is_the_derivative_of_the_energy_of_the_law():
    law, F = Law(0.4), exact.stretch_and_shear(1.1)

    def energy(F):
        J = np.linalg.det(F)
        return law.mu / 2.0 * (np.sum(F * F) - 3.0 - 2.0 * np.log(J)) + law.lam / 2.0 * (J - 1.0) ** 2

    for i, j in np.ndindex(3, 3):
        step = np.zeros((3, 3), dtype=complex)
        step[i, j] = 1e-30j
        assert law.first_piola(F)[i, j] == pytest.approx(energy(F + step).imag / 1e-30, rel=1e-13, abs=1e-15)


def test_uniaxial_stress_leaves_the_sides_free():
    for nu, stretch in ((0.3, 0.5), (0.499, 2.0)):
        law = Law(nu)
        stress, lateral = law.uniaxial(stretch)
        P = law.first_piola(np.diag([stretch, lateral, lateral]))
        np.testing.assert_allclose(np.diag(P), [stress, 0.0, 0.0], atol=1e-12)


def test_our_own_law_inflates_as_the_closed_form_in_the_incompressible_limit():
    radii, stretch = (1.0, 2.0), 1.5
    error = []
    for nu in (0.499, 0.49999):
        closed, own = incompressible(Law(nu).mu, radii, stretch), compressible(Law(nu), radii, stretch)
        error.append([own.pressure / closed.pressure - 1.0, own.outer_radius / closed.outer_radius - 1.0])
    np.testing.assert_allclose(error[1], np.array(error[0]) / 100.0, rtol=0.02)  # both by the bulk modulus


def test_the_manufactured_gradient_is_that_of_its_displacement():
    field = order.Manufactured(wave=1.5, shear=0.4, volume=0.1)
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 3))
    F = field.gradient(points)
    for j in range(3):
        step = 1e-30j * np.eye(3)[j]
        column = (points + step + field.displacement(points + step)).imag / 1e-30
        np.testing.assert_allclose(F[..., j], column, atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(F), field.volume_ratio(points), rtol=1e-13)
    assert np.ptp(field.volume_ratio(points)) > 0.01


def test_body_force_balances_the_stress_of_the_manufactured_solution():
    """The divergence theorem on a box: the total of body force and tractions is nothing."""
    law, field, mesh = Law(0.4), order.Manufactured(wave=1.5, shear=0.4, volume=0.1), box((4, 4, 4), (2.0, 2.0, 2.0))
    inside = equilibrium.body_load(mesh, lambda points: law.body_force(field.gradient, points)).sum(axis=0)
    outside = equilibrium.surface_load(mesh, mesh.faces, lambda points: law.first_piola(field.gradient(points)))
    np.testing.assert_allclose(inside + outside.sum(axis=0), 0.0, atol=1e-5 * np.abs(outside).sum())  # quadrature


def test_a_load_of_constant_stress_is_stress_times_area_and_has_no_moment():
    mesh = perturbed(box(), shift=0.2, bend=0.1, inside_only=True)
    load = equilibrium.surface_load(mesh, top(mesh.nodes, mesh.faces), exact.constant(np.eye(3)))
    area = face_geometry(P2P1, mesh.nodes, top(mesh.nodes, mesh.faces)).areas.sum()
    np.testing.assert_allclose(load.sum(axis=0), [0.0, -area, 0.0], atol=1e-12)
    np.testing.assert_allclose(np.cross(mesh.nodes, load).sum(axis=0), 0.0, atol=1e-12)


def test_an_equilibrium_that_cannot_be_found_says_which_step():
    mesh = box((1, 1, 1), (1.0, 1.0, 1.0))
    fixed = np.ones(mesh.nodes.shape, dtype=bool)
    body = equilibrium.make_body(mesh, 0.499, "cpu")
    with pytest.raises(RuntimeError, match=r"step 1 of 2.*inside out"):
        equilibrium.solve(body, fixed, -2.1 * mesh.nodes * [0.0, 1.0, 0.0], steps=2)


def softer(mesh, poisson_ratio, device):
    """A body whose shear modulus is wrong by one part in a million."""
    right = NeoHookean.from_engineering(1.0, poisson_ratio, 3.0)
    wrong = NeoHookean(right.mu * (1.0 + 1e-6), right.lam, right.gamma, right.pressure_compliance)
    active = ActiveEnvironments(1, device)
    return Elasticity(P2P1, mesh.nodes, mesh.tetrahedra, mesh.n_corners, wrong, device, active)


def test_cases_notice_a_wrong_modulus(monkeypatch):
    monkeypatch.setattr(exact, "make_body", softer)
    assert not any(row.passed for row in exact.simple_shear(CONTEXT).rows)


def test_cases_notice_a_tangent_that_is_none(monkeypatch):
    right = operator.tangent_action
    monkeypatch.setattr(operator, "tangent_action", lambda body, x, v: right(body, x, v) * (1.0 + 3e-6))
    rows = {row.quantity: row for row in operator.tangent(CONTEXT).rows}
    assert not rows["elasticity: least relative error of central differences"].passed
    assert rows["contact: least relative error of central differences"].passed


def test_orders_are_slopes():
    assert order.order([1.0, 0.5, 0.25], [3.0, 3.0 / 8.0, 3.0 / 64.0]) == pytest.approx(3.0)
    line = order.slope_line("plot", [1.0, 0.5], 0.1, 2, ("x", "y"))
    assert line.y == pytest.approx([0.4, 0.1]) and math.isclose(line.x[1], 0.5)
