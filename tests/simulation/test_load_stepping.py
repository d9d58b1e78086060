"""Load stepping: order of presses, initial guesses, failed tries, halved and repeated increments."""

import numpy as np
import pytest

from simgen.config.solver_settings import SolverSettings
from simgen.fem.contact.contact import Contact
from simgen.fem.device import combined
from simgen.fem.linear_solver.preconditioner import BlockTriangular
from simgen.fem.nonlinear.force_balance import ForceBalance
from simgen.fem.nonlinear.newton import MULTIPLIER_UPDATE_RESIDUAL, UPHILL_ITERATIONS, NewtonSolver
from simgen.fem.nonlinear.status import Status
from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from simgen.simulation.load_stepping import MAX_OVERLAP_RATIO, MAX_REPEATS, LoadStepping
from simgen.simulation.measurements import take_samples
from simgen.simulation.press import Scene, begin_presses, follow, press
from simgen.simulation.state_sampler import StateSampler
from simulation.blocks import CUBE, DEPTHS, GEL, RIGID_EDGE, SPHERE, make_block, pose
from simulation.failing_steps import fail_beyond
from simulation.gpu_rounds import as_on_a_gpu


def test_presses_that_touch_the_most_go_first(monkeypatch):
    loaded = []
    load = Scene.load

    def watch(scene, environments, shape_of):
        loaded.append(int(shape_of[0]))
        load(scene, environments, shape_of)

    monkeypatch.setattr(Scene, "load", watch)
    small = rigid_shape(Kind.SPHERE, 0.8)
    results = press(Scene(make_block((8, 2, 8)), GEL), [small, CUBE, SPHERE], np.tile(pose(), (3, 1, 1)), DEPTHS)
    assert loaded[1:] == [1, 2, 0]  # the first call is the scene's own, back to rest
    forces = [np.linalg.norm(result.force[-1]) for result in results]
    assert forces[1] > forces[2] > forces[0]  # and the results come in the order of the presses


def test_multipliers_rest_far_from_balance(block, monkeypatch):
    """A tilted cube's first contact overshoots, and multipliers must not follow there."""
    out_of_balance, followed = [], []
    measure, update = ForceBalance.measure, Contact.update_multipliers

    def watch(balance, x):
        measured = measure(balance, x)
        load = float(measured.load_norm[0])
        out_of_balance.append(float(measured.residual_norm[0]) / load if load else np.inf)
        return measured

    def watch_update(contact):
        followed.append(out_of_balance[-1])
        update(contact)

    monkeypatch.setattr(ForceBalance, "measure", watch)
    monkeypatch.setattr(Contact, "update_multipliers", watch_update)
    result = press(Scene(block, GEL), [CUBE], pose(tilt_deg=10.0), np.array([0.1e-3, 0.2e-3]))[0]
    assert (result.status == 0).all()
    assert max(out_of_balance) > 0.99  # 1: the whole contact force is out of balance
    assert 0.0 < max(followed) <= MULTIPLIER_UPDATE_RESIDUAL


def test_the_force_hardly_depends_on_the_load_step():
    """With friction; 0.31 % if points stuck where a straight way at constant speed ends."""
    scene = Scene(make_block((12, 4, 12)), GEL, settings=SolverSettings(contact_tolerance=5e-3))
    assert GEL.friction > 0.5
    fine, coarse = (press(scene, [SPHERE], pose(), 1e-3 * np.arange(1, n + 1) / n)[0].force[-1, 1] for n in (40, 10))
    print(f"{100 * (coarse / fine - 1):.3f} %")
    assert coarse == pytest.approx(fine, rel=2e-3)


def test_a_tiny_step_between_two_long_ones_hardly_changes_the_force():
    """0.5 mm as 0.25 + 0.25, and as 0.25 + 0.001 + 0.249: a tiny increment tells little of where points will stick."""
    scene = Scene(make_block((12, 4, 12)), GEL, settings=SolverSettings(contact_tolerance=5e-3))
    whole, parted = (press(scene, [SPHERE], pose(), 1e-3 * np.array(depths))[0].force[-1, 1]
                     for depths in ([0.25, 0.5], [0.25, 0.251, 0.5]))  # fmt: skip
    assert parted == pytest.approx(whole, rel=5e-3)


def test_friction_begins_anew_after_the_indenter_has_left():
    """After shear and lift-off, a press in one step of 2.5 times the last length equals a first press.

    The step goes back along the line of the last one, so an extrapolation would predict other entry points.
    """
    wide = make_block((12, 2, 12))
    path = [[0.0, 0.4, 0.0], [0.3, 0.4, 0.0], [0.6, 0.4, 0.0], [0.9, 0.4, 0.0], [0.6, 0.4, 0.0], [0.0, 0.4, 0.0],
            [0.0, 0.1, 0.0], [0.0, -0.1, 0.0], [0.0, 0.0, 0.0], [0.0, 0.4, 0.0]]  # fmt: skip
    again, fresh = (follow(Scene(wide, GEL), [SPHERE], pose(), np.array(part) * 1e-3)[0] for part in (path, path[:1]))
    assert (again.status == 0).all() and not again.force[-3].any()
    np.testing.assert_allclose(again.force[-1], fresh.force[-1], atol=1e-3 * fresh.force[-1, 1])


def test_multigrid_is_rebuilt_rarely_in_a_batch(monkeypatch):
    """As on a GPU, solved systems go on for some iterations; few Newton iterations rebuild multigrid."""
    made = []
    follow_state = BlockTriangular.rebuild_multigrid

    def watch(preconditioner):
        made.append(int((preconditioner.elasticity.active.numpy() >= 0).sum()))
        follow_state(preconditioner)

    monkeypatch.setattr(BlockTriangular, "rebuild_multigrid", watch)
    as_on_a_gpu(monkeypatch)
    scene = Scene(make_block((8, 2, 8)), GEL, batch=2)
    scene.solver.systems._solve_together = True
    results = press(scene, [SPHERE, CUBE], np.tile(pose(), (2, 1, 1)), np.array([0.2e-3, 0.4e-3, 0.6e-3, 0.8e-3]))
    newton = sum(result.certificate["newton_iterations"].sum() for result in results)
    assert all((result.status == 0).all() for result in results)
    assert 8 <= sum(made) < 0.5 * newton


def test_a_press_that_fails_is_tried_once_more_from_rest_in_half_steps(block, monkeypatch):
    scene = Scene(block, GEL, settings=SolverSettings(smallest_substep=0.5))
    depths = np.array([0.1e-3, 0.2e-3, 0.3e-3, 0.4e-3])
    in_half_steps = press(scene, [SPHERE], pose(), np.linspace(0.05e-3, 0.4e-3, 8))[0]
    fail_beyond(monkeypatch, (0.25, np.inf))
    tried_twice = press(scene, [SPHERE], pose(), depths)[0]
    assert (tried_twice.status == 0).all() and (tried_twice.certificate["substeps"] == 2).all()
    np.testing.assert_allclose(tried_twice.displacement, in_half_steps.displacement[1::2], atol=1e-12)


@pytest.mark.parametrize("most, increments", [(1000, (0.1, 0.2, 0.3, 0.25)), (2, (0.1, 0.2, 0.3))])
def test_a_try_that_has_taken_too_many_iterations_ends_where_an_increment_fails(block, monkeypatch, most, increments):
    """Without the limit of iterations the step would be halved first."""
    scene, targets = Scene(block, GEL, settings=SolverSettings(smallest_substep=0.25)), []
    monkeypatch.setattr("simgen.simulation.load_stepping.MAX_ITERATIONS", most)
    fail_beyond(monkeypatch, (0.22, 0.22))
    accept = LoadStepping._accept_or_reject

    def watch(stepping, ended):
        if ended.any() and len(stepping.press[0].tries) == 1:
            targets.append(round(float(stepping.target[0]), 6))
        accept(stepping, ended)

    monkeypatch.setattr(LoadStepping, "_accept_or_reject", watch)
    result = press(scene, [SPHERE], pose(), np.array([0.1e-3, 0.2e-3, 0.3e-3, 0.4e-3]))[0]
    assert result.status.tolist() == [0, 0, Status.NEWTON_STALLED, Status.NEWTON_STALLED]
    assert tuple(targets[: len(increments)]) == increments
    assert len(targets) == len(increments) or most == 1000


@pytest.mark.parametrize("second", [0.05, 0.12, 0.32])
def test_the_try_that_got_further_is_kept(block, monkeypatch, second):
    """The result is the same if two presses run in a batch."""
    scene = Scene(block, GEL, batch=2, settings=SolverSettings(smallest_substep=0.5))
    depths, poses = np.array([0.1e-3, 0.2e-3, 0.3e-3, 0.4e-3]), np.tile(pose(), (2, 1, 1))
    fail_beyond(monkeypatch, (0.25, second))
    plain, both = press(scene, [SPHERE], pose(), depths)[0], press(scene, [SPHERE, SPHERE], poses, depths)
    reached = max(2, int(second / 0.1))
    assert plain.status.tolist() == [0] * reached + [Status.NEWTON_STALLED] * (4 - reached)
    assert np.isfinite(plain.displacement[:reached]).all() and np.isnan(plain.displacement[reached:]).all()
    for result in both:
        np.testing.assert_array_equal(result.displacement, plain.displacement)


@pytest.mark.parametrize("furthest", [(0.25, np.inf), (0.25, 0.12), (np.inf, np.inf), (np.inf, 0.12)])
def test_a_second_try_beside_the_first_changes_no_result_and_saves_time(block, monkeypatch, furthest):
    """The second try begins right after the first, which counts if it reaches its end."""
    settings, depths = SolverSettings(smallest_substep=0.5), np.array([0.1e-3, 0.2e-3, 0.3e-3, 0.4e-3])
    fail_beyond(monkeypatch, furthest)
    as_on_a_gpu(monkeypatch)
    iterations, tries, advance = [0, 0], [0, 0], LoadStepping.advance

    def watch(stepping):
        advance(stepping)
        iterations[stepping.scene.batch - 1] += 1
        tries[stepping.scene.batch - 1] = max(tries[stepping.scene.batch - 1], stepping.remaining)

    monkeypatch.setattr(LoadStepping, "advance", watch)
    plain = press(Scene(block, GEL, settings=settings), [SPHERE], pose(), depths)[0]
    monkeypatch.setattr("simgen.simulation.load_stepping.SECOND_TRY_ITERATIONS", -1)
    scene = Scene(block, GEL, batch=2, settings=settings)
    beside = press(scene, [SPHERE], pose(), depths)[0]
    assert tries == [1, 2] and not scene.solver.working.any()
    np.testing.assert_array_equal(beside.status, plain.status)
    np.testing.assert_array_equal(beside.displacement, plain.displacement)
    np.testing.assert_array_equal(beside.certificate["newton_iterations"], plain.certificate["newton_iterations"])
    assert iterations[1] < iterations[0] if furthest[0] < 1.0 else iterations[1] == iterations[0]


def test_no_load_step_is_longer_than_a_quarter_of_a_millimetre(block):
    """One stored depth has the same state as the last of three depths."""
    settings = SolverSettings(residual_tolerance=1e-6, contact_tolerance=1e-4)
    depths = np.array([0.25e-3, 0.5e-3, 0.75e-3])
    at_once, stepwise = (press(Scene(block, GEL, settings=settings), [SPHERE], pose(), part)[0]
                         for part in (depths[-1:], depths))  # fmt: skip
    assert at_once.certificate["substeps"].tolist() == [3] and stepwise.certificate["substeps"].tolist() == [1, 1, 1]
    np.testing.assert_allclose(at_once.displacement[-1], stepwise.displacement[-1], atol=1e-12)


@pytest.mark.parametrize(("longest", "reached"), [(0.06, 3), (0.0, 2)])
def test_a_step_that_overlaps_the_indenter_too_far_is_halved(block, monkeypatch, longest, reached):
    """Steps longer than ``longest`` overlap too far beyond the second depth."""
    scene, depths = Scene(block, GEL, settings=SolverSettings(smallest_substep=0.4)), np.array([0.1e-3, 0.2e-3, 0.3e-3])
    measured, repeat = StateSampler.overlap, LoadStepping._repeat
    too_far = []

    def watch(stepping, ended):
        too_far[:] = (stepping.target - stepping.travelled > longest) & (stepping.target > 0.25)
        return repeat(stepping, ended)

    def overlap(samples):
        far = 2.0 * MAX_OVERLAP_RATIO
        return combined(
            [measured(samples)], lambda found: found._replace(of_edge=np.where(too_far, far, found.of_edge))
        )

    monkeypatch.setattr(LoadStepping, "_repeat", watch)
    monkeypatch.setattr(StateSampler, "overlap", overlap)
    result = press(scene, [SPHERE], pose(), depths)[0]
    assert result.status.tolist() == [0] * reached + [Status.NOT_RESOLVED] * (3 - reached)
    if reached == 3:
        assert result.certificate["substeps"][2] > result.certificate["substeps"][1]


def test_samples_have_the_overlap_of_their_states(block):
    """The state of the last sample is still there; the other sample has less overlap."""
    scene = Scene(block, GEL)
    result = press(scene, [SPHERE], pose(), np.array([0.1e-3, 0.4e-3]))[0]
    scene.solver.mark(np.ones(1, dtype=bool))
    first, last = result.certificate["max_penetration_m"]
    assert last == max(StateSampler.of(scene).overlap().read().deepest_mm[0], 0.0) / 1e3
    assert 0.0 < first < last


def test_a_press_whose_state_cannot_be_kept_leaves_the_sample_beside_it_alone(block, monkeypatch):
    """Both have converged at the same time, and are measured together."""
    poses, overlap, taken = np.concatenate([pose(x=-0.5), pose(x=0.5)]), StateSampler.overlap, []
    alone = press(Scene(block, GEL), [SPHERE], poses[1:], DEPTHS[:1])[0]

    def first_too_far(sampler):
        marked = sampler.scene.solver.active.chosen
        taken.append(marked.tolist())
        edge = np.array([2.0 * MAX_OVERLAP_RATIO, 0.0])
        return combined([overlap(sampler)], lambda found: found._replace(of_edge=edge))

    monkeypatch.setattr(StateSampler, "overlap", first_too_far)
    first, second = press(Scene(block, GEL, batch=2), [SPHERE] * 2, poses, DEPTHS[:1])
    assert taken[0] == [True, True] and first.status[0] == Status.NOT_RESOLVED
    for name in ("displacement", "force", "contact_area"):
        np.testing.assert_array_equal(getattr(second, name), getattr(alone, name))


@pytest.mark.parametrize(("overlap_mm", "status"), [(0.0, Status.CONVERGED), (0.02, Status.NOT_RESOLVED)])
def test_an_indenter_that_overlaps_without_a_force_is_not_resolved(block, monkeypatch, overlap_mm, status):
    """The second sample has no force: the indenter has left the surface, or lies between its integration points."""
    measured, taken = StateSampler.overlap, []

    def without_force(*given):
        samples = take_samples(*given)
        samples.values["force"][:] *= not taken
        taken.append(samples)
        return samples

    monkeypatch.setattr("simgen.simulation.load_stepping.take_samples", without_force)
    deepest = np.full(1, overlap_mm)
    monkeypatch.setattr(
        StateSampler, "overlap", lambda own: combined([measured(own)], lambda found: found._replace(deepest_mm=deepest))
    )
    result = press(Scene(block, GEL), [SPHERE], pose(), np.array([0.1e-3, 0.2e-3]))[0]
    assert result.status.tolist() == [0, status] and len(taken) == 2


@pytest.mark.parametrize(("most", "statuses"), [(25, [0, 0, 0, 0]), (0, [0, 0, 0, 9])])
def test_only_short_increments_are_repeated_for_elements_that_are_inside_out(block, monkeypatch, most, statuses):
    scene = Scene(block, GEL)
    monkeypatch.setattr(scene.solver.elasticity, "expect", lambda x: None)  # nothing is stabilised before
    monkeypatch.setattr("simgen.simulation.load_stepping.REPEATABLE_ITERATIONS", most)
    result = press(scene, [RIGID_EDGE], pose(), np.array([1.2e-3, 1.6e-3, 1.8e-3, 2.0e-3]))[0]
    assert result.status.tolist() == statuses
    stabilised = result.certificate["stabilised_elements"]
    assert (stabilised[-1] > 0) == (most > 0)
    assert (result.certificate["residual"] <= scene.settings.residual_tolerance).all()


@pytest.mark.parametrize(("converged", "halved"), [(False, True), (True, False)])
def test_a_failed_repeat_is_solved_from_its_start_only_if_the_increment_had_converged(block, converged, halved):
    """An increment that looked early may never have converged: it is halved at once."""
    scene = Scene(block, GEL)
    scene.reset([SPHERE])
    stepping = LoadStepping(scene, np.array([[0.0, 0.2, 0.0, 0.0]]), np.inf)
    begin_presses(stepping, [SPHERE], [0], pose(), np.array([1]))
    stepping.advance()
    before = stepping.target[0]
    stepping.repeats[0], stepping.converged_once[0] = 1, converged
    scene.solver.increment.status[0] = Status.NEWTON_STALLED
    stepping._accept_or_reject(np.ones(1, dtype=bool))
    assert stepping.step[0] == (0.5 * before if halved else before)
    assert (stepping.repeats[0] > MAX_REPEATS) != halved and not stepping.converged_once[0]


def test_elements_that_will_be_inverted_are_stabilised_before_an_increment_converges(block, monkeypatch):
    """An increment after a repeated one looks early. The states are nearly the same, and meet the same tolerance."""
    depths, begin, ended_early = np.arange(1.2, 2.05, 0.1) * 1e-3, NewtonSolver.begin, []

    def watch(solver, environments, looks_early):
        ended_early.append(bool(solver.increment.inverted[0]))
        begin(solver, environments, looks_early)

    scene = Scene(block, GEL)
    monkeypatch.setattr(scene.solver.elasticity, "expect", lambda x: None)  # nothing is stabilised before
    monkeypatch.setattr(NewtonSolver, "begin", watch)
    early = press(scene, [RIGID_EDGE], pose(), depths)[0]
    assert any(ended_early)
    monkeypatch.setattr(NewtonSolver, "begin", lambda solver, environments, _: begin(solver, environments))
    late = press(scene, [RIGID_EDGE], pose(), depths)[0]
    assert not early.status.any() and not late.status.any()
    np.testing.assert_allclose(early.force[:, 1], late.force[:, 1], rtol=1e-3)
    assert (early.certificate["residual"] <= scene.settings.residual_tolerance).all()


@pytest.mark.parametrize(("iteration", "damped"), [(UPHILL_ITERATIONS, False), (UPHILL_ITERATIONS + 1, True)])
def test_a_step_that_goes_uphill_is_not_taken_but_damped(block, monkeypatch, iteration, damped):
    """One step reports negative work, which only the first steps may have. The state is the same."""
    path, spheres = np.array([[0.0, 0.4e-3, 0.0], [0.3e-3, 0.4e-3, 0.0]]), [SPHERE]
    plain = follow(Scene(block, GEL), spheres, pose(), path)[0]
    assert not plain.certificate["damping"].any() and (plain.certificate["newton_iterations"] > UPHILL_ITERATIONS).all()
    scene, measure, measure_step = Scene(block, GEL), ForceBalance.measure, ForceBalance.measure_step
    steps, told = [], []  # told: residuals where the step begins, and of the next state

    def step(balance):
        steps.append(scene.solver.increment.newton_iterations[0])
        measure_step(balance)

    def uphill(balance, x):
        found = measure(balance, x)
        if len(told) == 1:
            told.append(found.residual_norm[0])
        if not told and steps[-1:] == [iteration]:
            told.append(scene.solver._residual_norm[0])
            assert found.work_at_start[0] > 0.0
            return found._replace(work_at_start=-found.work_at_start)
        return found

    monkeypatch.setattr(ForceBalance, "measure_step", step)
    monkeypatch.setattr(ForceBalance, "measure", uphill)
    result = follow(scene, spheres, pose(), path)[0]
    assert (result.status == 0).all()
    assert (told[1] == told[0]) == damped  # back to where the step began
    assert (result.certificate["damping"] > 0.0).tolist() == [damped, False]  # only the sample that it was for
    np.testing.assert_allclose(result.force, plain.force, rtol=5e-3, atol=1e-3)
