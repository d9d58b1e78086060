"""Load steps that take long are also solved in halves: which of both goes on, and what is left of a press."""

from types import SimpleNamespace

import numpy as np
import pytest

from simgen.config.solver_settings import SolverSettings
from simgen.fem.nonlinear.newton import NewtonSolver
from simgen.fem.nonlinear.status import Status
from simgen.simulation import halved_steps, load_stepping
from simgen.simulation.halved_steps import superseded
from simgen.simulation.load_stepping import LoadStepping
from simgen.simulation.press import Scene, begin_presses
from simgen.simulation.press_queue import PressQueue
from simulation.blocks import GEL, SPHERE, pose

CONVERGED, FAILED = Status.CONVERGED, Status.NEWTON_STALLED
WHOLE, FIRST_HALF, SECOND_HALF = (0.0, 0.2), (0.0, 0.1), (0.1, 0.2)  # mm: travelled, target


@pytest.mark.parametrize(
    ("half", "ended", "dropped"),
    [
        (FIRST_HALF, (CONVERGED, None), (False, True)),
        (SECOND_HALF, (CONVERGED, None), (False, True)),
        (FIRST_HALF, (None, CONVERGED), (False, False)),  # it goes on with the second half
        (SECOND_HALF, (None, CONVERGED), (True, False)),
        (SECOND_HALF, (CONVERGED, CONVERGED), (False, True)),
        (FIRST_HALF, (FAILED, None), (True, False)),
        (SECOND_HALF, (FAILED, None), (True, False)),
        (FIRST_HALF, (None, FAILED), (False, False)),  # it is halved again
        (SECOND_HALF, (None, FAILED), (False, False)),
        ((0.1, 0.2 - 3e-17), (None, CONVERGED), (True, False)),  # rounding
        (FIRST_HALF, (FAILED, FAILED), (True, False)),
        (FIRST_HALF, (FAILED, CONVERGED), (True, False)),
        (SECOND_HALF, (FAILED, CONVERGED), (True, False)),
    ],
)
def test_the_one_that_comes_further_first_goes_on(half, ended, dropped):
    assert superseded(*beside(half, ended)).tolist() == [*dropped, False, False]


def test_a_whole_step_that_had_converged_is_solved_once_more():
    stepping, ended = beside(FIRST_HALF, (FAILED, None))
    stepping.converged_once[0] = True
    assert not superseded(stepping, ended).any()


def beside(half, ended) -> tuple[SimpleNamespace, np.ndarray]:
    """Environments of a whole step, its half, another press whose step fails, and a free one; where steps ended."""
    travelled, target = np.transpose([WHOLE, half, WHOLE, (0.0, 0.0)])
    one, other = object(), object()
    status = np.array([0 if each is None else each for each in (*ended, FAILED, None)])
    stepping = SimpleNamespace(
        solver=SimpleNamespace(increment=SimpleNamespace(status=status)), tries=[one, one, other, None],
        travelled=travelled, target=target, converged_once=np.zeros(4, dtype=bool),
    )  # fmt: skip
    return stepping, np.array([*(each is not None for each in ended), True, False])


def pressed(block, batch=2, race=True, watch=lambda stepping: None, element="P2-P1"):
    """A sphere, pressed to 0.2 and 0.4 mm as in a race."""
    scene = Scene(block, GEL, batch=batch, settings=SolverSettings(smallest_substep=1e-3, element=element))
    scene.reset([SPHERE])
    stepping = LoadStepping(scene, np.array([[0.0, 0.2, 0.0, 0.0], [0.0, 0.4, 0.0, 0.0]]), np.inf)
    [one] = begin_presses(stepping, [SPHERE], [0], pose(), np.array([2]))
    one.race = race
    while one.status is None:
        stepping.advance()
        watch(stepping)
    assert stepping.press == stepping.tries == [None] * batch and not stepping.solver.working.any()
    return one


def count_halves(monkeypatch, after: int) -> list[float]:
    """Begin halves after so many Newton iterations; returns a list of the targets, mm, of those that begin."""
    monkeypatch.setattr(halved_steps, "HALVE_AFTER", after)
    begin, targets = halved_steps.begin_halves, []

    def count(stepping):
        halves = begin(stepping)
        targets.extend((stepping.travelled + stepping.step)[halves].tolist())
        return halves

    monkeypatch.setattr(load_stepping, "begin_halves", count)
    return targets


def forces(press) -> np.ndarray:
    return np.array([sample.value("force") for sample in press.samples])


def iterations(press) -> list[int]:
    return [sample.value("certificate/newton_iterations") for sample in press.samples]


def test_a_whole_step_that_converges_is_as_without_halves(block, monkeypatch):
    """The halves need more iterations here, and are dropped: no number changes."""
    alone = pressed(block)
    targets = count_halves(monkeypatch, 2)
    one = pressed(block)
    assert targets == pytest.approx([0.1, 0.3])
    np.testing.assert_array_equal(forces(one), forces(alone))
    assert iterations(one) == iterations(alone)


def test_halves_go_on_while_the_whole_step_takes_long(block, monkeypatch):
    """The second step never ends. Its halves reach its end, and the force there is that of the whole step."""
    alone = pressed(block)
    targets, most = count_halves(monkeypatch, 3), []
    iterate, advance, now = NewtonSolver.iterate, LoadStepping.advance, []

    def endless(solver):
        [stepping], ended = now, iterate(solver)
        whole = ended & (stepping.travelled == 0.2) & (stepping.target == 0.4)
        solver.working |= whole
        return ended & ~whole

    def note(stepping):
        now[:] = [stepping]
        advance(stepping)

    monkeypatch.setattr(NewtonSolver, "iterate", endless)
    monkeypatch.setattr(LoadStepping, "advance", note)
    one = pressed(block, batch=3, watch=lambda stepping: most.append(int(stepping.running.sum())))
    assert targets == pytest.approx([0.1, 0.3]) and max(most) == 2
    assert one.status == Status.CONVERGED and len(one.samples) == 2
    np.testing.assert_allclose(forces(one)[:, 1], forces(alone)[:, 1], rtol=5e-3)
    assert [sample.value("certificate/substeps") for sample in one.samples] == [1, 3]  # the whole one and two halves
    assert iterations(one)[1] > 3 + 2


@pytest.mark.parametrize(
    ("race", "batch", "most", "element"),
    [(False, 2, 16, "P2-P1"), (True, 1, 16, "P2-P1"), (True, 2, 1, "P2-P1"), (True, 2, 16, "P1")],
)
def test_without_a_race_or_room_and_with_factors_no_step_is_halved(block, monkeypatch, race, batch, most, element):
    monkeypatch.setattr(halved_steps, "MOST_RUNNING", most)
    targets = count_halves(monkeypatch, 1)
    one = pressed(block, batch, race, element=element)
    assert not targets and one.status == Status.CONVERGED


def test_while_presses_wait_no_step_is_halved(block, monkeypatch):
    targets = count_halves(monkeypatch, 1)
    monkeypatch.setattr(PressQueue, "__len__", lambda queue: 1)
    one = pressed(block)
    assert not targets and one.status == Status.CONVERGED
