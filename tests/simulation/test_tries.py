"""Tries of a press: which one is kept, and when the press ends."""

import gc
import weakref
from collections import Counter
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from simgen.config.solver_settings import SolverSettings
from simgen.fem.nonlinear.status import Status
from simgen.pipeline.presser import Pools
from simgen.simulation import halved_steps
from simgen.simulation.halved_steps import HALVE_AFTER
from simgen.simulation.load_stepping import LoadStepping
from simgen.simulation.pool import Pool
from simgen.simulation.press import Scene, begin_presses, press
from simgen.simulation.tries import FEW_TRIES, STEP_SCALES, Press, more_tries, second_tries
from simulation.blocks import GEL, SPHERE, pose
from simulation.failing_steps import fail_beyond


def tried(*tries, race=False):
    """A press with tries (samples, status, failed), and the tries; a running try has status None."""
    press = Press(0, np.eye(4), 0.0, 3, 0.0, race)
    for samples, status, failed in tries:
        one = press.next_try()
        one.samples, one.status, one.failed = [{}] * samples, status, failed
    own = list(press.tries)
    press.decide()
    return press, own


UNDER_WAY = (1, None, False)
WHOLE = (3, Status.CONVERGED, False)


def stepping_of(block) -> LoadStepping:
    """Stepping of two presses at once, along a path of one depth."""
    scene = Scene(block, GEL, batch=2)
    scene.reset([SPHERE])
    return LoadStepping(scene, np.array([[0.0, 0.2, 0.0, 0.0]]), np.inf)


def one_press(stepping: LoadStepping) -> Press:
    """A press that waits for an environment."""
    return begin_presses(stepping, [SPHERE], [0], pose(), np.array([1]))[0]


def failed(samples, status=Status.NEWTON_STALLED):
    return samples, status, True


def test_the_second_try_takes_half_steps_and_the_third_those_of_the_first():
    assert [each.step_scale for each in tried(*[UNDER_WAY] * 4)[1]] == [1.0, 0.5, 1.0, 0.7]


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


@pytest.mark.parametrize(
    ("tries", "kept"),
    [
        ((UNDER_WAY, WHOLE), 1),
        ((WHOLE, UNDER_WAY), 0),
        ((WHOLE, WHOLE), 0),
        ((failed(2), WHOLE), 1),
        ((UNDER_WAY, (1, Status.FORCE_LIMIT, False)), 1),
        (((2, None, False), (1, Status.FORCE_LIMIT, False)), None),
        ((UNDER_WAY, failed(2)), None),
        ((failed(2), UNDER_WAY), None),
        ((failed(2), failed(1)), None),
        ((failed(2), failed(1), failed(2)), None),
        ((failed(2), failed(1), UNDER_WAY), None),
        ((failed(2), (1, Status.NOT_RESOLVED, False), WHOLE), 2),
        ((failed(2), (1, Status.FORCE_LIMIT, False), UNDER_WAY), 1),
        ((UNDER_WAY, failed(2), UNDER_WAY, WHOLE), 3),
        ((UNDER_WAY, WHOLE, WHOLE), 1),
        ((failed(1), failed(2), failed(2), failed(1)), 2),
    ],
)
def test_in_a_race_the_try_that_completes_first_counts_unless_a_running_one_is_further(tries, kept):
    press, own = tried(*tries, race=True)
    assert press.kept is (None if kept is None else own[kept])
    assert press.status == (None if kept is None else own[kept].status)


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


@pytest.mark.parametrize(("device", "race"), [("cpu", False), ("cuda:0", True)])
def test_tries_race_on_a_gpu_only(block, monkeypatch, device, race):
    """On a CPU, results must not depend on free environments."""
    stepping = stepping_of(block)
    stepping.scene.device = device
    touch = np.zeros(1), np.zeros(1, dtype=int), np.ones(1)
    monkeypatch.setattr("simgen.simulation.press.first_touch", lambda *args: touch)
    assert one_press(stepping).race == race


def test_two_tries_may_end_in_the_same_iteration(block, monkeypatch):
    monkeypatch.setattr("simgen.simulation.load_stepping.SECOND_TRY_ITERATIONS", -1)
    depths = np.array([0.1e-3, 0.2e-3])
    plain = press(Scene(block, GEL), [SPHERE], pose(), depths)[0]
    monkeypatch.setattr("simgen.simulation.tries.STEP_SCALES", (1.0, 1.0))
    both = press(Scene(block, GEL, batch=2), [SPHERE], pose(), depths)[0]
    np.testing.assert_array_equal(both.displacement, plain.displacement)


@pytest.mark.parametrize(("race", "tries"), [(False, (1, 1)), (True, (2, 0))])
def test_on_a_cpu_no_second_try_begins_beside_the_first_while_presses_wait(block, monkeypatch, race, tries):
    monkeypatch.setattr("simgen.simulation.load_stepping.SECOND_TRY_ITERATIONS", -1)
    stepping = stepping_of(block)
    first = one_press(stepping)
    first.race = race
    stepping._start_tries()
    waiting = one_press(stepping)
    stepping._start_tries()
    assert (len(first.tries), len(waiting.tries)) == tries


def two_tries(block, monkeypatch, doubt: int, second: float = 0.25) -> tuple[LoadStepping, Press]:
    """Stepping and a press; a second try may begin after ``doubt`` iterations.

    The first try fails before its second depth, and the second try beyond ``second`` mm.
    """
    monkeypatch.setattr("simgen.simulation.load_stepping.SECOND_TRY_ITERATIONS", doubt)
    fail_beyond(monkeypatch, (0.25, second))
    scene = Scene(block, GEL, batch=2, settings=SolverSettings(smallest_substep=1e-3))
    scene.reset([SPHERE])
    stepping = LoadStepping(scene, np.array([[0.0, 0.2, 0.0, 0.0], [0.0, 0.4, 0.0, 0.0]]), np.inf)
    [one] = begin_presses(stepping, [SPHERE], [0], pose(), np.array([2]))
    return stepping, one


@pytest.mark.parametrize("doubt", [5, 15])
def test_a_second_try_begins_when_the_first_has_taken_so_many_iterations_for_a_depth(block, monkeypatch, doubt):
    stepping, one = two_tries(block, monkeypatch, doubt)
    while len(one.tries) < 2:
        spent = stepping.cost[0, 0]
        stepping.advance()
    assert spent > doubt and len(one.tries[0].samples) == 1


def test_a_second_try_begins_when_the_first_has_taken_so_many_iterations_in_all(block, monkeypatch):
    stepping, one = two_tries(block, monkeypatch, 10_000)
    monkeypatch.setattr("simgen.simulation.load_stepping.SECOND_TRY_AFTER", 15)
    while len(one.tries) < 2:
        spent, since_sample = stepping._try_iterations[0], stepping.cost[0, 0]
        stepping.advance()
    assert 15 < spent < 40 and since_sample < spent and len(one.tries[0].samples) == 1


def test_in_a_race_a_press_ends_with_its_second_try_and_leaves_both_environments(block, monkeypatch):
    stepping, one = two_tries(block, monkeypatch, 5, second=np.inf)
    one.race = True
    stepping.advance()
    [first] = one.tries
    while stepping.remaining:
        stepping.advance()
    assert first.status is None and len(first.samples) == 1  # it is still under way
    assert one.status == Status.CONVERGED and one.kept.step_scale == 0.5 and len(one.samples) == 2
    assert stepping.press == stepping.tries == [None, None] and not stepping.solver.working.any()


def racing(tries: int) -> Press:
    """A press of a race with so many tries under way."""
    return tried(*[UNDER_WAY] * tries, race=True)[0]


def begun(presses) -> list[Press]:
    """The presses, after the next try of each has begun."""
    return [press for press in presses if press.next_try()]


def test_slow_presses_of_a_race_have_up_to_four_tries_while_few_run():
    one, two, four = racing(1), racing(2), racing(4)
    assert begun(more_tries([four, two, one], 3)) == [two, two]  # the second try of a press waits for nothing
    two, again = racing(2), racing(3)
    assert begun(more_tries([two, again], FEW_TRIES - 2)) == [two, two]
    assert begun(more_tries([again], FEW_TRIES)) == []


def test_without_a_race_a_press_has_two_tries_and_the_second_waits_until_no_press_waits():
    press, again = tried(UNDER_WAY)[0], tried(UNDER_WAY, UNDER_WAY)[0]
    assert second_tries([press, again], none_waits=True) == [press]
    assert second_tries([press, racing(1)], none_waits=False)[0].race
    assert begun(more_tries([press, again], 0)) == []


def test_in_a_race_four_tries_run_beside_each_other(block, monkeypatch):
    """The third one gets to the end first, and ends the press."""
    monkeypatch.setattr("simgen.simulation.load_stepping.SECOND_TRY_ITERATIONS", 5)
    fail_beyond(monkeypatch, (0.25, 0.1, np.inf, 0.1))
    scene = Scene(block, GEL, batch=6, settings=SolverSettings(smallest_substep=1e-3))
    scene.reset([SPHERE])
    stepping = LoadStepping(scene, np.array([[0.0, 0.2, 0.0, 0.0], [0.0, 0.4, 0.0, 0.0]]), np.inf)
    [one] = begin_presses(stepping, [SPHERE], [0], pose(), np.array([2]))
    one.race, most = True, 0
    while stepping.remaining:
        tries = one.tries
        stepping.advance()
        most = max(most, int(stepping.running.sum()))
    assert most == len(STEP_SCALES) and one.kept is tries[2]
    assert one.status == Status.CONVERGED and len(one.samples) == 2
    assert stepping.press == stepping.tries == [None] * 6 and not stepping.solver.working.any()


def test_in_a_race_a_press_fails_once_four_tries_have_failed(block, monkeypatch):
    """With one environment they run one after the other."""
    fail_beyond(monkeypatch, (0.25, 0.1, 0.3, 0.1))
    scene = Scene(block, GEL, settings=SolverSettings(smallest_substep=1e-3))
    scene.reset([SPHERE])
    stepping = LoadStepping(scene, np.array([[0.0, 0.2, 0.0, 0.0], [0.0, 0.4, 0.0, 0.0]]), np.inf)
    [one] = begin_presses(stepping, [SPHERE], [0], pose(), np.array([2]))
    one.race = True
    while stepping.remaining:
        tries = one.tries
        stepping.advance()
    assert [each.step_scale for each in tries] == list(STEP_SCALES)
    assert one.status == Status.NEWTON_STALLED and one.kept is tries[2] and len(one.samples) == 1


def test_tries_that_end_together_end_their_press_once(block):
    scene = Scene(block, GEL, batch=3)
    scene.reset([SPHERE])
    stepping = LoadStepping(scene, np.array([[0.0, 0.2, 0.0, 0.0]]), np.inf)
    one = one_press(stepping)
    one.race = True
    stepping._start_tries()
    for env in (1, 2):
        stepping.press[env], stepping.tries[env] = one, one.next_try()
        stepping.running[env] = True
    one.tries[0].samples = [{}]
    stepping._end(1, Status.FORCE_LIMIT)  # the first try is further
    assert one.status is None
    for env in (0, 2):
        stepping._end(env, Status.NEWTON_STALLED, failed=True)
    assert one.status == Status.FORCE_LIMIT and stepping.press == [None] * 3


def test_a_press_is_dropped_with_both_its_tries(block, monkeypatch):
    stepping, one = two_tries(block, monkeypatch, -1)
    for _ in range(3):
        stepping.advance()
    assert stepping.running.all() and stepping.press == [one, one]
    stepping.drop([one])
    assert stepping.remaining == 0 and stepping.press == stepping.tries == [None, None]
    assert not stepping.solver.working.any()


@pytest.mark.parametrize("halve_after", [HALVE_AFTER, 2])
def test_races_in_two_pools_lose_no_press(block, monkeypatch, halve_after):
    """The tries of presses at 0, 1 and -1 mm fail once, twice and never, and those of tilted presses always.

    Once with the usual load steps, and once with many that are also begun in halves.
    """
    monkeypatch.setattr(halved_steps, "HALVE_AFTER", halve_after)
    accept, begin, begun = LoadStepping._accept_or_reject, Press.next_try, Counter()

    def failing(press):
        return 4 if press.pose[0, 1] else {0: 1, 1: 2, -1: 0}[round(press.pose[0, 3])]

    def reject(stepping, ended):
        for env in np.flatnonzero(ended & (stepping.target > 0.25)):
            press = stepping.press[env]
            if press is not None and press.tries.index(stepping.tries[env]) < failing(press):
                stepping.solver.increment.status[env] = Status.NEWTON_STALLED
        accept(stepping, ended)

    def next_try(press):
        press.race = True
        begun[press] += 1
        return begin(press)

    def make_pool(beside=None):
        path = np.array([[0.0, 0.2e-3, 0.0], [0.0, 0.4e-3, 0.0]])
        return Pool(Scene(block, GEL, batch=3), [SPHERE], path, np.zeros(2), np.inf, beside)

    monkeypatch.setattr(LoadStepping, "_accept_or_reject", reject)
    monkeypatch.setattr(Press, "next_try", next_try)
    monkeypatch.setattr("simgen.simulation.load_stepping.SECOND_TRY_AFTER", 8)
    first, poses = make_pool(), np.concatenate([pose(), pose(x=1.0), pose(tilt_deg=5.0), pose(x=-1.0)])
    pools = Pools([first, make_pool(first)])
    tasks = [pools.press([0] * 4, poses, np.full(4, 2)) for _ in range(3)]
    with ThreadPoolExecutor(3) as threads:
        assert [len(results) for results in threads.map(list, tasks)] == [4, 4, 4]
    for one in (each for task in tasks for each in task.presses):
        fails = failing(one)
        assert one.status == (Status.NEWTON_STALLED if fails == 4 else Status.CONVERGED)
        assert begun[one] > fails or begun[one] == fails == 4
