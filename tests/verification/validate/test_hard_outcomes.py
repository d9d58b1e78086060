"""Outcomes of hard presses: as declared or not, with certificates or without."""

from dataclasses import replace

import pytest

from simgen.simulation.press import Status
from simgen.verification.validate.hard import SPHERE
from simgen.verification.validate.hard_outcomes import GIVEN_UP, Attempt, attempt, evidence, verdicts
from simgen.verification.validate.hard_scenes import above_block, block, down, scene_of


@pytest.fixture(scope="module")
def pressed() -> Attempt:
    return attempt("a press", scene_of(block(), "cpu"), SPHERE, above_block(), down(0.4, 2))


def ending(a: Attempt, status: Status, **changes) -> Attempt:
    """Copy an attempt with another status of its last sample."""
    codes = a.result.status.copy()
    codes[-1] = status
    return replace(a, result=replace(a.result, outputs=a.result.outputs | {"status": codes}), **changes)


def test_a_press_that_converges(pressed):
    assert pressed.as_declared and pressed.reached == pytest.approx(0.4) and pressed.outcome == "converges"
    assert [row.quantity for row in verdicts([pressed]) if not row.passed] == []
    table = evidence("one", [pressed])
    assert [len(row) for row in table.rows] == [len(table.columns)]


def test_what_is_declared_decides(pressed):
    assert not ending(pressed, Status.INVERTED).as_declared
    assert ending(pressed, Status.INVERTED, refusals=GIVEN_UP).as_declared
    assert not ending(pressed, Status.NEVER_TOUCHES, refusals=GIVEN_UP).as_declared
    assert not replace(pressed, refusals=GIVEN_UP).as_declared  # it converges, but should fail
    ended = ending(pressed, Status.INVERTED)
    assert ended.reached == pytest.approx(0.2)
    assert ended.outcome.startswith("NOT AS DECLARED") and Status.INVERTED.sentence in ended.outcome


def test_a_refused_press_fails_its_row(pressed):
    first, *_ = verdicts([pressed, ending(pressed, Status.NEWTON_STALLED)])
    assert not first.passed and (first.ours, first.reference) == (1, 2)


def test_a_press_refused_at_once_has_no_certificate():
    scene = scene_of(block(), "cpu")
    away = attempt("away", scene, SPHERE, above_block(x_mm=30.0), down(0.4, 2), (Status.NEVER_TOUCHES,))
    assert away.as_declared and away.reached == 0.0 and len(verdicts([away])) == 2
    assert [len(row) for row in evidence("one", [away]).rows] == [len(evidence("one", []).columns)]
