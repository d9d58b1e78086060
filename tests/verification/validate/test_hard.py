"""Measures of the hard cases."""

from simgen.verification.validate.hard import SPHERE, torque
from simgen.verification.validate.hard_outcomes import attempt
from simgen.verification.validate.hard_scenes import above_block, block, down, scene_of


def test_a_sphere_has_no_torque_without_friction():
    smooth = attempt("smooth", scene_of(block(), "cpu", friction=0.0), SPHERE, above_block(x_mm=1.0), down(0.4, 2))
    assert torque(smooth, above_block(x_mm=1.0)).max() < 1e-12
