"""Comparison of codes: differences fail, and absent packages are skipped."""

import dataclasses

import numpy as np
import pytest

from simgen.verification.validate import peers
from simgen.verification.validate.peer_scene import PeerSolution


def made_up(code: str, force: float = 1.0, shift_mm: float = 0.0) -> PeerSolution:
    d = len(peers.STEPS_MM)
    displacement = np.full((d, len(peers.surface_points()), 3), 0.1)
    displacement[..., 1] += shift_mm
    return PeerSolution(code, 1000, 1.0, 10, 0, np.full(d, force), displacement)


def test_codes_that_agree_pass():
    outcome = peers.compare(made_up("peer"), made_up("simgen", force=1.009, shift_mm=0.004))
    assert len(outcome.rows) == 4
    assert all(row.passed for row in outcome.rows)
    assert [row.ours for row in outcome.rows if row.unit == "um"] == pytest.approx([4.0, 4.0])


@pytest.mark.parametrize(("ours", "unit"), [({"force": 1.011}, "N"), ({"shift_mm": 0.006}, "um")])
def test_codes_that_differ_fail(ours, unit):
    outcome = peers.compare(made_up("peer"), made_up("simgen", **ours))
    assert {row.unit for row in outcome.rows if not row.passed} == {unit}


def test_a_press_that_did_not_converge_fails():
    broken = made_up("simgen")
    broken = dataclasses.replace(broken, force=np.full_like(broken.force, np.nan))
    assert not broken.converged
    assert not any(row.passed for row in peers.compare(made_up("peer"), broken).rows if row.unit == "N")


def test_an_absent_package_is_skipped():
    outcome = peers.against("no_such_package", made_up, "cpu")
    assert "no_such_package is not installed" in outcome.skipped
    assert outcome.rows == []


def test_equal_presses_at_once_have_the_result_of_one():
    alone, together = (peers.solve(peers.WARM_UP, [0.1], "cpu", presses=presses) for presses in (1, 3))
    np.testing.assert_array_equal(alone.force, together.force)
    np.testing.assert_array_equal(alone.displacement, together.displacement)
