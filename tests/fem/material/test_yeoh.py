"""The Yeoh law: neo-Hookean without its constants, and stiffer with them, at a point and in a press."""

from dataclasses import replace

import numpy as np

from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from simgen.simulation.press import press
from simgen.verification.validate.hard_scenes import above_block, block, scene_of
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


def test_a_press_into_a_block_stiffens_with_depth():
    """Without constants all forces are the neo-Hookean ones. With them small depths differ little, large ones a lot."""
    sensor, sphere, depths = block(), rigid_shape(Kind.SPHERE, 3.5), np.array([0.2e-3, 1.0e-3])
    plain, none, stiffer = (
        press(scene_of(sensor, "cpu", **law), [sphere], above_block()[None], depths)[0]
        for law in ({}, {"law": "yeoh"}, {"law": "yeoh", "c20_pa": 2e4, "c30_pa": 2e4})
    )
    assert not plain.status.any() and not none.status.any() and not stiffer.status.any()
    np.testing.assert_allclose(none.force, plain.force, rtol=0.0, atol=1e-9 * np.abs(plain.force).max())
    gain = stiffer.force[:, 1] / plain.force[:, 1] - 1.0
    assert 0.0 < gain[0] < 0.2 * gain[1]
    assert gain[1] > 0.05
