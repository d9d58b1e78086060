"""Interpolated forces: exact at knots and simulated depths, near a formula between, a power of depth below."""

import numpy as np
import pytest

from calibration.rigs import MESH_ERROR, FormulaRig, formula
from simgen.calibration.force_table import DEPTHS, ForceTable, depths_to, needed

FREE = ("nu", "friction")


@pytest.fixture(scope="module")
def table():
    rig = FormulaRig()
    return ForceTable(rig, rig.values(), (*FREE, "offset"), depths_to(2.0, 0.1))


def test_depths_reach_the_deepest_with_its_offset():
    depths = depths_to(2.0, 0.1)
    assert depths_to(2.0)[-1] == 2.0
    assert len(depths) == DEPTHS and depths[-1] == pytest.approx(2.2) and depths[0] == pytest.approx(0.11)


def test_forces_at_knots_are_those_of_the_presses(table):
    depth = table.depth_mm
    for nu, friction in ((0.3, 0.0), (0.475, 0.2), (0.4999, 1.0)):
        force = table.force({"nu": nu, "friction": friction}, depth)
        np.testing.assert_allclose(force, formula(nu, friction, 0.0, depth), rtol=1e-12)


def test_forces_between_follow_the_formula(table):
    depth = np.linspace(0.15, 2.2, 50)
    for nu, friction in ((0.36, 0.05), (0.46, 0.25), (0.495, 0.7)):
        force = table.force({"nu": nu, "friction": friction}, depth)
        np.testing.assert_allclose(force, formula(nu, friction, 0.0, depth), rtol=0.02)


def test_small_depths_follow_a_power_and_none_has_no_force(table):
    values = {"nu": 0.475, "friction": 0.0}
    force = table.force(values, np.array([-0.1, 0.0, 0.01, 0.02, 0.04]))
    assert (force[:2] == 0.0).all() and (np.diff(force[1:]) > 0.0).all()
    slopes = np.diff(np.log(force[2:])) / np.log(2.0)
    assert slopes == pytest.approx([slopes[0]] * 2) and slopes[0] == pytest.approx(1.5, abs=0.1)
    assert table.mesh_error(values, np.array([0.5])) == pytest.approx([MESH_ERROR])


def test_all_combinations_of_knots_are_needed_once():
    values = [tuple(sorted(each.items())) for each in needed({"c20": 0.0, "c30": 0.0}, FREE)]
    assert len(values) == len(set(values)) == 36
