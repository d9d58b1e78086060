"""One environment each: what is taken, and which share of the step is tried next."""

import numpy as np
import pytest

from simgen.fem.nonlinear.force_balance import StateMeasures
from simgen.fem.nonlinear.line_search import MAX_GROWTH, MAX_TRIALS, LineSearch

ONE = np.array([True])


def tried(work=0.0, size=1.0):
    return StateMeasures(*(np.array([value]) for value in (1.0, size, work, 0.0, 0.9, 0.0, np.nan, np.nan)))


def begun(work=1.0, norms=10.0):
    search = LineSearch(1)
    search.begin(ONE, np.array([1.0]), np.array([work]), np.array([norms]))
    return search


def judge(search, measured, guess=False):
    taken, again = search.judge(measured, np.array([guess]), ONE)
    return bool(taken[0]), bool(again[0])


@pytest.mark.parametrize("work", [0.0, 0.2, -0.2, 0.9])
def test_a_step_that_does_not_overshoot_is_taken_whole(work):
    assert judge(begun(), tried(work)) == (True, False)


def test_a_step_that_overshoots_is_cut_by_the_secant_until_it_fits():
    search = begun()
    assert judge(search, tried(work=-1.0)) == (False, True)
    assert search.alpha[0] == pytest.approx(0.5)  # between work 1 at none and -1 at the whole of it
    assert judge(search, tried(work=0.5)) == (False, True)  # now it falls short of what is bracketed
    assert search.alpha[0] == pytest.approx(0.5 + 0.5 * (0.5 / 1.5))
    assert judge(search, tried(work=0.1)) == (True, False)


def test_the_zero_of_a_bent_curve_is_found_where_one_end_of_the_interval_stays():
    """Work 1 - 10 alpha^2: plain regula falsi ends at 0.43."""
    search = begun()
    for _ in range(MAX_TRIALS):
        alpha = search.alpha[0]
        taken, _ = judge(search, tried(work=1.0 - 10.0 * alpha**2))
        if taken:
            break
    assert taken and abs(1.0 - 10.0 * alpha**2) < 0.2


@pytest.mark.parametrize("bad", [{"size": np.nan}, {"size": 1.1 * MAX_GROWTH}])
def test_a_state_that_cannot_be_used_halves_the_step_and_at_last_fails(bad):
    search = begun()
    for trial in range(1, MAX_TRIALS):
        assert judge(search, tried(**bad)) == (False, True)
        assert search.alpha[0] == 0.5**trial
    assert judge(search, tried(**bad)) == (False, False)


def test_work_that_is_rounding_says_nothing():
    assert judge(begun(work=1e-14, norms=1.0), tried(work=-1.0)) == (True, False)


def test_a_guess_is_taken_if_its_forces_are_finite():
    assert judge(LineSearch(1), tried(work=-9.0, size=1e9), guess=True) == (True, False)
    assert judge(LineSearch(1), tried(size=np.inf), guess=True) == (False, False)
