"""Limits of the parameters of a fit: every combination is a material that the solver takes."""

from itertools import product

import pytest

from simgen.calibration.parameters import NAMES, OFFSET, PRESSED, limits
from simgen.sensors.material import Material


def test_the_offset_is_limited_by_the_deepest_depth():
    assert limits(OFFSET, 2.0) == pytest.approx((-0.2, 0.2))
    assert limits("friction", 2.0) == (0.0, 1.0) and (*PRESSED, OFFSET) == NAMES


def test_all_knots_are_stable_materials():
    for nu, friction, c20, c30 in product(*(each.knots for each in PRESSED.values())):
        constants = {"law": "yeoh", "c20_pa": 1e6 * c20, "c30_pa": 1e6 * c30}
        Material(youngs_modulus_pa=1e6, poisson_ratio=nu, friction=friction, **constants)
