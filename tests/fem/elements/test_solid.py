"""The modulus at a point: damping changes the tangent alone."""

import numpy as np
import pytest

from simgen.fem.elements.element import P2P1
from simgen.fem.material import LAWS
from tests.fem.elements.test_elasticity import action, body, residual


@pytest.mark.parametrize("law", LAWS)
def test_damping_adds_the_stress_of_a_viscous_increment_to_the_tangent_alone(law):
    """At rest cof F is the unit matrix: the damped part is eta mu times the Laplacian, whose energy a shear states."""
    nodes, term = body(P2P1, law=law)
    rest = np.zeros(term.n_displacements + term.n_pressures)
    shear = np.zeros_like(rest)
    shear[: term.n_displacements : 3] = nodes[:, 1]  # dF = e_x e_y^T
    plain, forces = action(term, rest, shear), residual(term, 0.1 * shear)[0]
    term.damp(np.array([0.5]))
    damped = action(term, rest, shear)
    volume = np.prod(nodes.max(axis=0) - nodes.min(axis=0))
    assert shear @ (damped - plain) == pytest.approx(0.5 * term.material.mu * volume, rel=1e-4)
    np.testing.assert_array_equal(residual(term, 0.1 * shear)[0], forces)
