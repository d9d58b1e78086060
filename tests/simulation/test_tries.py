"""Tries of a press: which one is kept, and when the press ends."""

import gc
import weakref

import numpy as np
import pytest

from simgen.fem.nonlinear.status import Status
from simgen.simulation.tries import SECOND_TRY_SCALE, Press


def tried(*tries):
    """A press with tries (samples, status, failed), and the tries; a running try has status None."""
    press = Press(0, np.eye(4), 0.0, 3, 0.0)
    for samples, status, failed in tries:
        one = press.next_try()
        one.samples, one.status, one.failed = [{}] * samples, status, failed
    own = list(press.tries)
    press.decide()
    return press, own


UNDER_WAY = (1, None, False)
WHOLE = (3, Status.CONVERGED, False)


def failed(samples, status=Status.NEWTON_STALLED):
    return samples, status, True


def test_the_second_try_takes_half_steps():
    assert [each.step_scale for each in tried(UNDER_WAY, UNDER_WAY)[1]] == [1.0, SECOND_TRY_SCALE]


@pytest.mark.parametrize("tries", [(UNDER_WAY,), (failed(2),), (UNDER_WAY, WHOLE), (UNDER_WAY, failed(2)),
                                   (failed(2), UNDER_WAY)])  # fmt: skip
def test_a_press_goes_on_while_its_tries_do_not_decide(tries):
    press, _ = tried(*tries)
    assert press.status is None and press.samples == [] and press.large == {}


@pytest.mark.parametrize(
    ("tries", "kept"),
    [
        ((WHOLE,), 0),
        ((WHOLE, UNDER_WAY), 0),
        ((WHOLE, WHOLE), 0),
        ((WHOLE, failed(1)), 0),
        ((failed(2), WHOLE), 1),
        ((failed(2), (1, Status.FORCE_LIMIT, False)), 1),
        ((failed(2), failed(1, Status.NOT_RESOLVED)), 0),
        ((failed(1), failed(2, Status.NOT_RESOLVED)), 1),
        ((failed(2), failed(2, Status.NOT_RESOLVED)), 1),
    ],
)
def test_the_first_try_counts_unless_it_failed_and_then_the_one_that_got_further(tries, kept):
    press, own = tried(*tries)
    assert press.kept is own[kept] and press.tries == [own[kept]]
    assert press.status == press.kept.status and press.samples is press.kept.samples


def test_a_press_that_nobody_holds_gives_its_samples_back_at_once():
    """Reference cycles would keep gigabytes until the next garbage collection."""
    press, own = tried(failed(2), WHOLE)
    own[1].large = {"displacement": np.zeros((3, 4, 3))}
    samples = weakref.ref(own[1].large["displacement"])
    gc.disable()
    try:
        del press, own
        assert samples() is None
    finally:
        gc.enable()
