"""The hard cases' own tools; `test_quick` runs the quick cases."""

import math
from dataclasses import replace

import numpy as np
import pytest

from simgen.simulation.press import Status
from simgen.verification.validate.hard import SPHERE, torque
from simgen.verification.validate.hard_outcomes import GIVEN_UP, Attempt, attempt, evidence, verdicts
from simgen.verification.validate.hard_refusals import least_ratio, sliver, words
from simgen.verification.validate.hard_scenes import COUNTS, SIZE_MM, above_block, block, down, scene_of, sideways
from simgen.verification.validate.meshes import box


@pytest.fixture(scope="module")
def pressed() -> Attempt:
    return attempt("a press", scene_of(block(), "cpu"), SPHERE, above_block(), down(0.4, 2))


def ending(a: Attempt, status: Status, **changes) -> Attempt:
    """The attempt as if its last sample had been refused."""
    codes = a.result.status.copy()
    codes[-1] = status
    return replace(a, result=replace(a.result, status=codes), **changes)


def test_paths_in_metres():
    np.testing.assert_allclose(down(0.4, 2), [[0.0, 2e-4, 0.0], [0.0, 4e-4, 0.0]])
    np.testing.assert_allclose(sideways(1.0, 0.2, 2), [[1e-4, 1e-3, 0.0], [2e-4, 1e-3, 0.0]])


def test_a_press_that_converges(pressed):
    assert pressed.as_declared and pressed.reached == pytest.approx(0.4) and pressed.outcome == "converges"
    assert [row.quantity for row in verdicts([pressed]) if not row.passed] == []
    table = evidence("one", [pressed])
    assert [len(row) for row in table.rows] == [len(table.columns)]


def test_what_is_declared_decides(pressed):
    assert not ending(pressed, Status.INVERTED).as_declared
    assert ending(pressed, Status.INVERTED, refusals=GIVEN_UP).as_declared
    assert not ending(pressed, Status.NEVER_TOUCHES, refusals=GIVEN_UP).as_declared
    assert not replace(pressed, refusals=GIVEN_UP).as_declared  # it was to be refused, and converges
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


def test_a_sphere_has_no_torque_without_friction():
    smooth = attempt("smooth", scene_of(block(), "cpu", friction=0.0), SPHERE, above_block(x_mm=1.0), down(0.4, 2))
    assert torque(smooth, above_block(x_mm=1.0)).max() < 1e-12


@pytest.mark.parametrize("ratio", [0.1, 1e-3])
def test_slivers_as_bad_as_wanted(ratio):
    mesh = box((6, 3, 6), SIZE_MM)
    bad = sliver(mesh, ratio)
    assert least_ratio(bad) == pytest.approx(ratio, rel=1e-3)
    assert ((bad.nodes != mesh.nodes).any(axis=1)[: mesh.n_corners]).sum() == 1
    np.testing.assert_array_equal(bad.nodes[np.unique(mesh.faces)], mesh.nodes[np.unique(mesh.faces)])


def test_words_of_a_refusal():
    assert words(lambda: math.sqrt(-1.0)) and words(lambda: None) == ""
    with pytest.raises(KeyError):
        words(lambda: {}["a crash is no refusal"])


def test_the_block_is_bonded_at_its_bottom():
    mesh = block().simulation_mesh
    assert mesh.held.sum() == (mesh.nodes[:, 1] > 1e-3 * (SIZE_MM[1] - 1e-6)).sum() > 0
    assert len(mesh.tetrahedra) == 6 * math.prod(COUNTS)
