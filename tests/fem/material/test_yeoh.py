"""The Yeoh law: neo-Hookean without its constants, and stiffer in shear by the closed form with them."""

from dataclasses import replace

import numpy as np

from tests.fem.material.points import MU, SOLIDS, stress

NEO_HOOKEAN, YEOH = SOLIDS


def test_without_constants_it_is_the_neo_hookean_law():
    rng = np.random.default_rng(8)
    F, dF = np.eye(3) + 0.3 * rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
    for ours, theirs in zip(stress(replace(YEOH, c20=0.0, c30=0.0), F, dF), stress(NEO_HOOKEAN, F, dF), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-15)


def test_simple_shear_stiffens():
    for amount in (0.1, 1.0, 3.0):
        F = np.eye(3) + amount * np.outer([1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
        _, _, cauchy = stress(YEOH, F, p=0.0)
        slope = MU + 4.0 * YEOH.c20 * amount**2 + 6.0 * YEOH.c30 * amount**4  # s = amount^2
        np.testing.assert_allclose(cauchy, slope * F @ F.T - MU * np.eye(3), atol=1e-13)
        assert cauchy[0, 1] > MU * amount


def test_c20_leaves_less_to_the_volumetric_part():
    with_c20 = type(YEOH).from_engineering(1.0, 0.499, 1.0, c20=0.1, c30=0.3)
    without = type(YEOH).from_engineering(1.0, 0.499, 1.0)
    np.testing.assert_allclose(without.lam - with_c20.lam, 0.8)
    assert with_c20.kernel_constants == (0.1, 0.3)
