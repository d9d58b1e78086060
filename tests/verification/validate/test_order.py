"""The manufactured solution and how orders are measured."""

import math

import numpy as np
import pytest

from simgen.verification.validate import equilibrium, order
from simgen.verification.validate.meshes import box
from simgen.verification.validate.reference_law import ReferenceLaw


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
    law, field = ReferenceLaw(0.4), order.Manufactured(wave=1.5, shear=0.4, volume=0.1)
    mesh = box((4, 4, 4), (2.0, 2.0, 2.0))
    inside = equilibrium.body_load(mesh, lambda points: law.body_force(field.gradient, points)).sum(axis=0)
    outside = equilibrium.surface_load(mesh, mesh.faces, lambda points: law.first_piola(field.gradient(points)))
    np.testing.assert_allclose(inside + outside.sum(axis=0), 0.0, atol=1e-5 * np.abs(outside).sum())  # quadrature


def test_orders_are_slopes():
    assert order.order([1.0, 0.5, 0.25], [3.0, 3.0 / 8.0, 3.0 / 64.0]) == pytest.approx(3.0)
    line = order.slope_line("plot", [1.0, 0.5], 0.1, 2, ("x", "y"))
    assert line.y == pytest.approx([0.4, 0.1]) and math.isclose(line.x[1], 0.5)
