"""A live press, from the events of its worker."""

import numpy as np
import pytest

from simgen.config.indenter_path import DOWN, press_path, with_legs
from simgen.view.live_press import LivePress
from simgen.view.press_events import DepthReached, Lost, PressEnded, Ready, Refused, Stopped, Touched

DEPTHS_M = np.array([1e-4, 2e-4, 3e-4])
# Its press axis, the second column, is +z of the sensor.
POSE = np.array([[1.0, 0, 0, 0.01], [0, 0, -1, 0.02], [0, 1, 0, 0.03], [0, 0, 0, 1]])


def reached(step: int, newtons: float, press: int = 2) -> DepthReached:
    outputs = {"displacement": np.full((4, 3), newtons), "force": np.array([9.0, 8.0, newtons])}
    return DepthReached(press, step, outputs, 0.1 * newtons)


def ended(status: int, count: int) -> PressEnded:
    return PressEnded(2, status, "Over.", count, 1e-3, 4.5)


@pytest.fixture
def press() -> LivePress:
    return LivePress(2, press_path(DEPTHS_M))


def test_events_are_taken_in_order(press):
    assert press.indenter_pose(-1) is None and press.indenter_pose(2) is None
    assert [each.tolist() for each in press.axial_force()] == [[0.0], [0.0]]
    assert press.take(Touched(2, POSE))
    assert press.take(reached(0, 1.0)) and press.take(reached(1, 2.0))
    assert (press.reached, press.has_ended, press.seconds) == (2, False, 0.2)
    assert press.force(1) == 2.0 and press.displacement(1)[0, 0] == 2.0 and press.displacement(2) is None
    depths, forces = press.axial_force()
    np.testing.assert_allclose(depths, [0.0, 0.1, 0.2])
    assert forces.tolist() == [0.0, 1.0, 2.0]
    assert press.take(reached(2, 4.0)) and press.take(ended(0, 3))
    assert (press.reached, press.has_ended, press.is_good, press.sentence) == (3, True, True, "Over.")
    assert press.ending == "Over. 3 depths in 4.50 s."


@pytest.mark.parametrize(
    "event", [Touched(1, POSE), reached(0, 1.0, press=3), Stopped(1), Refused(0, "No."), Ready("digit", 1.0), Lost("?")]
)
def test_events_of_other_presses_are_not_taken(press, event):
    assert not press.take(event)
    assert press == LivePress(2, press.path)


def test_samples_beyond_the_last_step_that_counts_are_dropped(press):
    for event in (Touched(2, POSE), reached(0, 1.0), reached(1, 2.0), reached(2, 3.0), ended(1, 1)):
        press.take(event)
    assert list(press.outputs) == [0] and press.displacement(1) is None
    assert press.has_ended and not press.is_good


def test_a_second_try_replaces_samples(press):
    for event in (Touched(2, POSE), reached(0, 1.0), reached(1, 2.0), reached(0, 5.0)):
        press.take(event)
    assert press.reached == 2 and press.axial_force()[1].tolist() == [0.0, 5.0, 2.0]
    press.take(reached(1, 6.0))
    assert press.axial_force()[1].tolist() == [0.0, 5.0, 6.0]


def test_a_press_without_depths_ends_with_its_sentence_alone(press):
    press.take(Refused(2, "there: no room; allowed: elsewhere"))
    assert press.ending == "there: no room; allowed: elsewhere"


@pytest.mark.parametrize(
    "event, sentence, is_good", [(Stopped(2), "Stopped.", True), (Refused(2, "No room."), "No room.", False)]
)
def test_a_press_that_ends_early_keeps_its_samples(press, event, sentence, is_good):
    press.take(reached(0, 1.0))
    assert press.take(event)
    assert (press.has_ended, press.sentence, press.is_good, press.reached) == (True, sentence, is_good, 1)


def test_the_indenter_advances_from_first_touch(press):
    press.take(Touched(2, POSE))
    np.testing.assert_array_equal(press.indenter_pose(-1), POSE)
    for step, depth in enumerate(DEPTHS_M):
        pose = press.indenter_pose(step)
        np.testing.assert_array_equal(pose[:3, :3], POSE[:3, :3])
        np.testing.assert_allclose(pose[:3, 3], [0.01, 0.02, 0.03 + depth], rtol=1e-12)


def test_the_indenter_follows_a_path_sideways_and_turns():
    """After the press, the tip moves along the frame's x, turns by 90 degrees, and goes up to above first touch."""
    legs = [((5e-4, 0, 0), 0.0, 1), ((0, 0, 0), np.pi / 2, 1), (-4e-4 * DOWN, 0.0, 2)]
    press = LivePress(2, with_legs(press_path(DEPTHS_M), legs))
    press.take(Touched(2, POSE))
    np.testing.assert_allclose(press.indenter_pose(3)[:3, 3], [0.0105, 0.02, 0.0303], rtol=1e-12)
    np.testing.assert_allclose(press.indenter_pose(3)[:3, :3], POSE[:3, :3])
    x, y, z = press.indenter_pose(4)[:3, :3].T
    np.testing.assert_allclose([x, y, z], [-POSE[:3, 2], POSE[:3, 1], POSE[:3, 0]], atol=1e-9)
    np.testing.assert_allclose(press.indenter_pose(6)[:3, 3], [0.0105, 0.02, 0.0299], rtol=1e-12)
    assert press.deepest_m == 3e-4
