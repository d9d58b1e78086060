"""Presses that move to other environments of a batch while they are solved: no byte of a result changes."""

import numpy as np
import pytest

from simgen.fem.elements.elasticity import Elasticity
from simgen.fem.nonlinear.damping import TangentDamping
from simgen.fem.nonlinear.newton import NewtonSolver
from simgen.fem.nonlinear.status import Status
from simgen.simulation.load_stepping import LoadStepping
from simgen.simulation.press import DOWN, Scene, follow, press
from simulation.blocks import CUBE, DEPTHS, GEL, RIGID_EDGE, SPHERE, pose
from simulation.gpu_rounds import as_on_a_gpu


def watch_moves(monkeypatch) -> list[tuple[int, int, bool]]:
    """List the presses that move: from which environment to which, and True if within an increment."""
    moves, move = [], NewtonSolver.move

    def watch(solver, sources, targets):
        moves.extend(zip(sources.tolist(), targets.tolist(), solver.working[sources].tolist(), strict=True))
        move(solver, sources, targets)

    monkeypatch.setattr(NewtonSolver, "move", watch)
    return moves


def assert_same(one, other):
    for name in ("displacement", "force", "moment", "status"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    for name, values in one.certificate.items():
        np.testing.assert_array_equal(values, other.certificate[name], name)


def test_a_press_moves_to_a_free_environment_without_a_change(block, scene, monkeypatch):
    """When the first press has ended, one moves to its place. Bytes stay as those of a press alone."""
    moves = watch_moves(monkeypatch)
    as_on_a_gpu(monkeypatch)
    shapes, steps = [CUBE, SPHERE, SPHERE], np.array([1, 2, len(DEPTHS)])
    poses = np.concatenate([pose(tilt_deg=5.0), pose(), pose(x=1.0)])
    together = follow(Scene(block, GEL, batch=3), shapes, poses, DEPTHS[:, None] * DOWN, steps=steps)
    assert moves == [(2, 0, True)]
    monkeypatch.undo()
    for i, result in enumerate(together):
        alone = follow(scene, [shapes[i]], poses[i : i + 1], DEPTHS[:, None] * DOWN, steps=steps[i : i + 1])[0]
        for name in ("displacement", "force", "moment", "status"):
            np.testing.assert_array_equal(getattr(result, name), getattr(alone, name))


@pytest.mark.parametrize("damped", [False, True])
def test_presses_that_move_in_each_round_do_not_change(block, monkeypatch, damped):
    """Some elements are stabilised, and an increment fails: all that a press needs moves with it."""
    moves, accept, failures = watch_moves(monkeypatch), LoadStepping._accept_or_reject, []

    def any_columns(movable, free):
        movable, free = np.flatnonzero(movable), np.flatnonzero(free)
        count = min(len(movable), len(free))
        return movable[:count], free[len(free) - count :]

    def fail_once(stepping, ended):
        too_long = ended & (stepping.target > 1.2) & (stepping.target - stepping.travelled > 0.15)
        failures.extend(np.flatnonzero(too_long))
        stepping.solver.increment.status[too_long] = Status.NEWTON_STALLED
        accept(stepping, ended)

    monkeypatch.setattr(LoadStepping, "_accept_or_reject", fail_once)
    monkeypatch.setattr(Elasticity, "expect", lambda body, x: None)  # elements are stabilised once they are inverted
    if damped:
        begin = TangentDamping.begin

        def begin_damped(damping, environments):
            begin(damping, environments)
            damping.increase(environments)

        monkeypatch.setattr(TangentDamping, "begin", begin_damped)
    as_on_a_gpu(monkeypatch)
    shapes = [RIGID_EDGE, CUBE, SPHERE]
    poses = np.concatenate([pose(), pose(tilt_deg=8.0), pose(x=1.0, tilt_deg=-5.0)])
    depths = np.array([1.2e-3, 1.6e-3, 1.7e-3, 1.8e-3, 1.9e-3, 2.0e-3])
    alone = [press(Scene(block, GEL), [shapes[i]], poses[i : i + 1], depths)[0] for i in range(3)]
    assert not moves and failures and (alone[0].certificate["stabilised_elements"] > 0).any()
    monkeypatch.setattr("simgen.fem.batch_arrays.lower_columns", any_columns)
    monkeypatch.setattr("simgen.simulation.load_stepping.SECOND_TRY_ITERATIONS", 5)  # some begin after a move
    together = press(Scene(block, GEL, batch=8), shapes, poses, depths)
    assert len([inside for *_, inside in moves if inside]) > 50
    for result, other in zip(together, alone, strict=True):
        assert_same(result, other)


def test_a_press_that_moves_uses_no_factors_of_the_press_before(block, monkeypatch):
    begin, chosen = NewtonSolver.begin, []

    def first_by_factors(solver, environments, looks_early):
        if solver.n_env > 1 and not chosen:
            chosen.append(solver.preconditioner.switch_to_factors(np.arange(solver.n_env) == 0))
        begin(solver, environments, looks_early)

    moves = watch_moves(monkeypatch)
    as_on_a_gpu(monkeypatch)
    monkeypatch.setattr(NewtonSolver, "begin", first_by_factors)
    poses, path = np.concatenate([pose(tilt_deg=5.0), pose(x=1.0)]), DEPTHS[:, None] * DOWN
    together = follow(Scene(block, GEL, batch=2), [CUBE, SPHERE], poses, path, steps=np.array([1, 2]))
    assert [each[:2] for each in moves] == [(1, 0)] and chosen[0].any()
    alone = follow(Scene(block, GEL), [SPHERE], poses[1:], path)[0]
    np.testing.assert_array_equal(together[1].displacement, alone.displacement)
