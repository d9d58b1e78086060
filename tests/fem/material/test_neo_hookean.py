"""The neo-Hookean law in simple shear, against its closed form."""

import numpy as np

from tests.fem.material.points import GAMMA, MU, SOLIDS, stress


def test_simple_shear_has_the_shear_modulus_at_every_shear():
    for amount in (0.1, 1.0, 3.0):
        F = np.eye(3) + amount * np.outer([1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
        _, _, cauchy = stress(SOLIDS[0], F, p=0.0)
        expected = MU * np.array([[amount**2, amount, 0.0], [amount, 0.0, 0.0], [0.0, 0.0, 0.0]])
        np.testing.assert_allclose(cauchy, expected, atol=1e-14)


def test_a_change_of_volume_meets_the_pointwise_stiffness_and_the_pressure():
    t = 1.1
    first_piola, _, _ = stress(SOLIDS[0], t * np.eye(3), p=0.4)
    expected = MU * (t - 1.0 / t) + (GAMMA * (t**3 - 1.0) + 0.4) * t**2
    np.testing.assert_allclose(first_piola, expected * np.eye(3), rtol=1e-13)
