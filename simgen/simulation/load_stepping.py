"""Load stepping: presses advance along a path in increments (load steps), one press in each environment.

The solver advances all environments by one Newton iteration at a time. An environment whose increment has ended begins
its next increment at once, and a press that ends leaves its environment to the next press. On a CPU the results of a
press have the same bytes, whatever the other presses are. On a GPU the order of sums depends on the threads.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable

import numpy as np

from simgen.fem import batch_arrays
from simgen.fem.contact.contact import Last
from simgen.fem.device import read_together
from simgen.fem.nonlinear.newton import REPEATABLE_ITERATIONS
from simgen.fem.nonlinear.status import Status
from simgen.simulation.halved_steps import begin_halves, halve, partners, smallest_steps, superseded
from simgen.simulation.measurements import Solution, take_samples
from simgen.simulation.moving_presses import move_together
from simgen.simulation.press_path import PressPath, longest_way
from simgen.simulation.press_queue import PressQueue
from simgen.simulation.scene import Scene
from simgen.simulation.state_sampler import Measured, StateSampler
from simgen.simulation.tries import SECOND_TRY_AFTER, SECOND_TRY_ITERATIONS, Press, Try

MAX_EXTRAPOLATION = 3.0  # length of an extrapolation, in lengths of the last load step
GROWTH_DELAY = 4  # converged increments before a halved load step is doubled; a failed increment costs as much as four
MAX_OVERLAP_RATIO = 0.25  # share of the face's edge; with more overlap, the mesh does not resolve the contact
MIN_OVERLAP_MM = 0.01  # an indenter that overlaps more without a force lies between the integration points
# Newton iterations since the last sample, after which a failed increment ends the try. Of the 619,193 samples of two
# runs of the paired job (8a88ef0, 5c68dee; one H200) none took more than 951.
MAX_ITERATIONS = 1000
MAX_REPEATS = 12  # of an increment whose state has inverted elements or too much overlap


class LoadStepping:
    """Presses along one path, one in each environment of the scene, ``scene.batch`` at a time.

    path (d, 4): offsets, mm, and turns about the press axis, rad. A press ends after its last step, or where its force
    along the press axis exceeds ``max_force_n``, which may be infinite. The scene holds the indenters' shapes.
    ``travelled``, ``target`` and ``goal`` (env,) are path lengths in mm: at the last converged increment, at the end of
    the current increment, and at the next point to store. ``halved`` (env,) bool marks increments whose halves have
    begun beside them, see `halved_steps`. ``queue`` has the presses that wait for an environment.
    """

    _counted = 0.0  # s, time up to which wall time has been shared out among presses

    def __init__(self, scene: Scene, path: np.ndarray, max_force_n: float, queue: PressQueue | None = None):
        self.scene, self.solver, self.path, self._max_force_n = scene, scene.solver, PressPath(path), max_force_n
        self.sampler, self.queue = StateSampler.of(scene), PressQueue() if queue is None else queue
        batch = scene.batch
        self.press: list[Press | None] = [None] * batch
        self.tries: list[Try | None] = [None] * batch
        self.running, self._starting = np.zeros((2, batch), dtype=bool)  # has a try; begins its next increment
        self._shape, self._poses, self._reach = np.zeros(batch), np.tile(np.eye(4), (batch, 1, 1)), np.zeros(batch)
        self.travelled, self.previous, self.target, self.step = np.zeros((4, batch))
        self.successes = np.zeros(batch, dtype=int)  # converged increments since the last failed one
        self.repeats = np.zeros(batch, dtype=int)  # of the current increment
        self._damping, self._overlap_mm = np.zeros((2, batch))  # largest since a sample; deepest where one is due
        self._measured: tuple[np.ndarray, Measured] | None = None  # where a sample is due, (env,) bool, and its values
        self._reinforced = np.zeros(batch, dtype=bool)  # retried with reinforced elements
        self.repeated = np.zeros(batch, dtype=bool)  # the last increment was repeated
        self.converged_once = np.zeros(batch, dtype=bool)  # the current one has converged once, and was repeated
        self.halved = np.zeros(batch, dtype=bool)
        self._iterations_before = np.zeros(batch, dtype=np.int64)  # of the current tries, before the current increment
        self.step_scale = np.ones(batch)  # of the current tries
        self.goal, self.max_step = np.zeros(batch), np.full(batch, self.path.max_steps[0])  # on the current leg
        # Newton iterations of the current tries; Newton and Krylov iterations and sub-steps since the last sample
        self._try_iterations, self.cost = np.zeros(batch, dtype=np.int64), np.zeros((3, batch), dtype=np.int64)
        self.x_start, self.x_previous = self.solver.vector(), self.solver.vector()
        self._target_poses = np.tile(np.eye(4), (batch, 1, 1))

    def add(self, presses: Iterable[Press]):
        """Queue presses until environments are free."""
        for press in presses:
            if press.status is None and press.steps == 0:
                press.status = Status.NO_ROOM
            if press.status is None:
                self.queue.add(press)

    def drop(self, presses: Collection[Press]):
        """Forget presses whose results are not needed any more."""
        for press in presses:
            press.dropped = True
        self.queue.remove_dropped()
        self.release(np.array([press is not None and press.dropped for press in self.press]))

    @property
    def unfinished(self) -> list[Press]:
        return [*self.queue, *(press for press in self.press if press is not None)]

    @property
    def remaining(self) -> int:
        """Number of waiting presses, and of environments in use."""
        return len(self.queue) + int(self.running.sum())

    @property
    def has_slow_press(self) -> bool:
        """True if a running press is slow: see `PressQueue.is_slow`."""
        spent = zip(self.press, self._try_iterations, strict=True)
        return any(press is not None and self.queue.is_slow(press.shape, count) for press, count in spent)

    def advance(self):
        """Advance all running presses by one iteration."""
        begin = time.perf_counter()
        self._starting |= self._start_tries() | begin_halves(self)
        self.queue.note_room(not self.running.all())
        move_together(self)
        self._begin_increments(self._starting)
        self._starting[:] = False
        running = [press for press in self.press if press is not None]
        ended = self.solver.iterate()
        if ended.any():
            ended &= ~self._repeat(ended)
            self._accept_or_reject(ended)
            self._starting = ended & self.running
        # Iterations of several threads overlap: the common time counts once, for the iteration that ends first.
        now = time.perf_counter()
        begin, LoadStepping._counted = max(begin, LoadStepping._counted), now
        for press in running:
            press.seconds += (now - begin) / len(running)

    def _start_tries(self) -> np.ndarray:
        """Start tries in free environments; returns the environments (env,) bool that began one."""
        fresh, free = np.zeros(self.scene.batch, dtype=bool), np.flatnonzero(~self.running)
        if not len(free):
            return fresh
        slow = (self.cost[0] > SECOND_TRY_ITERATIONS) | (self._try_iterations > SECOND_TRY_AFTER)
        slow = sorted(np.flatnonzero(self.running & slow), key=lambda env: -self._try_iterations[env])
        slow = list(dict.fromkeys(self.press[env] for env in slow))
        beside_slow = self.queue.has_help and self.has_slow_press
        tries = {id(each) for each in self.tries if each is not None}  # some have two environments
        presses = self.queue.next_presses(slow, len(tries), beside_slow)
        for env, press in zip(free, presses, strict=False):  # an environment first, or a press would be lost
            self.press[env], self.tries[env] = press, press.next_try()
            self._shape[env], self._poses[env], self._reach[env] = press.shape, press.pose, press.lateral_reach
            self.step_scale[env] = self.tries[env].step_scale
            fresh[env] = True
        if not fresh.any():
            return fresh
        self.running |= fresh
        self.repeats[fresh] = self._try_iterations[fresh] = self.cost[:, fresh] = 0
        self.travelled[fresh] = self.previous[fresh] = self._damping[fresh] = 0.0
        self.successes[fresh] = GROWTH_DELAY
        self._reinforced[fresh] = self.repeated[fresh] = self.converged_once[fresh] = False
        self.step[fresh] = self.max_step[fresh] = self.step_scale[fresh] * self.path.max_steps[0]
        self.scene.load(fresh, self._shape)
        return fresh

    def _begin_increments(self, starting: np.ndarray):
        """Begin the next increment in the environments (env,) bool.

        The initial guess extrapolates displacements and multipliers of the last two states along the path. It also
        predicts where points enter contact.
        """
        if not starting.any():
            return
        solver = self.solver
        segment = [0 if each is None else min(len(each.samples), len(self.path) - 1) for each in self.tries]
        self.goal = self.path.lengths[1:][segment]
        max_step = self.step_scale * self.path.max_steps[segment]
        self.step = np.where(max_step != self.max_step, max_step, self.step)
        self.max_step = max_step
        target = np.minimum(self.travelled + self.step, self.goal)
        self.target = np.where(starting, np.where(self.goal - target < 1e-9, self.goal, target), self.target)
        path, here = self.path, self.path.offsets(self.travelled)
        last, now = here - path.offsets(self.previous), path.offsets(self.target) - here
        length = (last**2).sum(axis=-1)
        ratio = (last * now).sum(axis=-1) / np.where(length > 0.0, length, np.inf)
        continued = np.where(ratio <= MAX_EXTRAPOLATION, np.maximum(ratio, 0.0), 0.0)
        ratio = np.clip(ratio, 0.0, MAX_EXTRAPOLATION)
        self.halved[starting], self._iterations_before[starting] = False, self._try_iterations[starting]
        marked = solver.mark(starting)
        batch_arrays.copy(solver.x, marked, self.x_start)
        batch_arrays.extrapolate(self.x_previous, self.x_start, ratio, marked, solver.trial)
        for x in (self.x_start, solver.trial):
            solver.elasticity.expect(x)
        self._target_poses[starting] = path.poses(self._poses, self.target)[starting]
        at_rest, travel = np.tile(np.eye(4), (self.scene.batch, 1, 1)), longest_way(now, self._reach)
        before = path.poses(self._poses, self.travelled)
        last = Last(self.x_previous, path.poses(self._poses, self.previous), continued)
        start, guess = self.x_start, solver.trial
        self.scene.indenter_contact.begin_increment(start, guess, before, self._target_poses, travel, last)
        for contact in self.scene.fixed_contacts:
            contact.begin_increment(start, guess, at_rest, at_rest, travel, Last(self.x_previous, at_rest, continued))
        for contact in solver.contacts:
            contact.extrapolate(ratio)
        solver.begin(starting, self.repeated & (self.repeats < MAX_REPEATS))

    def _repeat(self, ended: np.ndarray) -> np.ndarray:
        """Repeat increments that have ended in a state that cannot be kept; returns their environments (env,) bool.

        Inverted elements are stabilised more, also before the increment converges if the last one was repeated. Where a
        sample is due, faces are stiffened if they overlap a rigid body too far, or if no skin is left between indenter
        and core; the increment fails if that does not help. If a repeated increment does not converge, it is solved
        once more from its start, and inverted elements are accepted. They are also accepted after `MAX_REPEATS`
        repeats, and where an increment took more Newton iterations than `REPEATABLE_ITERATIONS`.
        """
        solver, out = self.solver, self.solver.increment
        converged = ended & (out.status == Status.CONVERGED)
        repeatable = converged & (self.repeats < MAX_REPEATS)
        again = repeatable & (out.newton_iterations <= REPEATABLE_ITERATIONS)
        due = converged & (self.target == self.goal)
        readings = []
        if again.any():
            solver.mark(again)
            readings.append(solver.elasticity.stabilise(solver.x))
        if due.any():
            solver.mark(due)
            readings += [self.sampler.overlap(), self.sampler.measure(np.count_nonzero(due))]
        found = read_together(*readings)
        if again.any():
            again &= found[0] > 0
        again |= ended & out.inverted  # stabilised before it converged
        if due.any():
            overlap, self._measured = found[-2], (due, found[-1])
            self._overlap_mm[due] = overlap.deepest_mm[due]
            too_far = due & ((overlap.of_edge > MAX_OVERLAP_RATIO) | (overlap.room_mm < 0.0))
            out.status[too_far & ~repeatable] = Status.NOT_RESOLVED
            too_far &= repeatable
            if too_far.any():
                solver.mark(too_far)
                for contact in solver.contacts:
                    contact.stiffen(solver.x)
                again |= too_far
        if again.any():
            self.repeats[again] += 1
            self.converged_once |= again & converged
            self.count_cost(again)
            batch_arrays.copy(solver.x, solver.mark(again), solver.trial)
            solver.begin(again, self.repeats < MAX_REPEATS)
        return again

    @property
    def increment_iterations(self) -> np.ndarray:
        """Newton iterations (env,) of the current increments, with those before a repeat."""
        return self._try_iterations - self._iterations_before + self.solver.increment.newton_iterations

    def restore(self, environments: np.ndarray):
        """Go back to the start of the increments in the environments (env,) bool."""
        marked = self.solver.mark(environments)
        batch_arrays.copy(self.x_start, marked, self.solver.x)
        for contact in self.solver.contacts:
            contact.restore(marked)

    def count_cost(self, ended: np.ndarray):
        """Count the iterations of the increments that have ended (env,) bool."""
        out = self.solver.increment
        self.cost[:2, ended] += np.stack([out.newton_iterations, out.krylov_iterations])[:, ended]
        self._try_iterations[ended] += out.newton_iterations[ended]
        self._damping[ended] = np.maximum(self._damping, out.most_damping)[ended]

    def _accept_or_reject(self, ended: np.ndarray):
        """Keep the increments (env,) that have converged; undo the others and halve their steps, or end their tries."""
        solver, out = self.solver, self.solver.increment
        dropped = superseded(self, ended)
        self.release(dropped)
        ended = ended & ~dropped
        self.count_cost(ended)
        self.cost[2, ended] += 1
        converged = ended & (out.status == Status.CONVERGED)
        failed = ended & ~converged
        if failed.any():
            self.restore(failed)
        # An increment that had converged and whose repeat fails is solved from its start, without further repeats.
        unchecked = failed & self.converged_once & (self.repeats <= MAX_REPEATS) & (out.status != Status.NOT_RESOLVED)
        self.repeated[ended], self.converged_once[ended] = self.repeats[ended] > 0, False
        self.repeats[ended] = np.where(unchecked, MAX_REPEATS + 1, 0)[ended]
        failed &= ~unchecked
        if failed.any():
            halve(self, failed)
            too_short = self.step < smallest_steps(self)
            too_costly = failed & (self.cost[0] > MAX_ITERATIONS)
            reinforce = failed & too_short & ~too_costly & ~self._reinforced
            given_up = failed & too_short & ~reinforce | too_costly
            if reinforce.any():
                solver.elasticity.reinforce(solver.mark(reinforce))
                self._reinforced |= reinforce
                self.step[reinforce] = self.max_step[reinforce]
            for env in np.flatnonzero(given_up):
                if env in partners(self):
                    self.release(np.arange(self.scene.batch) == env)
                else:
                    self._end(env, out.status[env], failed=True)
        marked = solver.mark(converged)
        batch_arrays.copy(self.x_start, marked, self.x_previous)
        for contact in solver.contacts:
            contact.keep(marked)
        self.previous[converged] = self.travelled[converged]
        self.travelled[converged] = self.target[converged]
        self.successes[converged] += 1
        longer = converged & (self.successes >= GROWTH_DELAY)
        self.step[longer] = np.minimum(2.0 * self.step, self.max_step)[longer]
        self._store_samples(converged & (self.target == self.goal))

    def _end(self, env: int, status: int, failed: bool = False):
        """End a try. If its press's result is now certain, end the press; else the press waits for its other tries."""
        press, ended = self.press[env], self.tries[env]
        if press is None:
            return  # it has just ended with another try
        ended.status, ended.failed = status, failed
        self.queue.learn(press.shape, self._try_iterations[env])
        press.decide()
        if press.status is None:
            if press.all_failed:
                self.queue.add(press)
            self.release(np.array([each is ended for each in self.tries]))
        else:  # other tries may be running, too
            self.release(np.array([each is press for each in self.press]))

    def release(self, environments: np.ndarray):
        """Remove the tries from the environments (env,) bool."""
        for env in np.flatnonzero(environments):
            self.press[env] = self.tries[env] = None
        self.running &= ~environments
        self._starting &= ~environments
        self.solver.abandon(environments)

    def _store_samples(self, reached: np.ndarray):
        """Store samples in the environments (env,) bool that have just reached a point to store."""
        if not reached.any():
            return
        out = self.solver.increment
        solution = Solution(out.residual, out.contact_error, out.min_det, self._damping, *self.cost)
        (due, measured), self._measured = self._measured, None
        measured = measured.keep(reached[due])
        samples = take_samples(self.sampler, reached, self._poses, solution, self._overlap_mm, measured)
        force, environments = samples.values["force"], samples.environments
        too_strong = np.abs((force * self._poses[environments, :3, 1]).sum(axis=1)) > self._max_force_n
        missed, overlaps = ~force.any(axis=1), self._overlap_mm[environments] > MIN_OVERLAP_MM
        for place, env in enumerate(environments):
            if (current := self.tries[env]) is None:  # the press has just ended with another try
                continue
            entered = not current.samples and self.path.points[0, 1] > MIN_OVERLAP_MM
            if too_strong[place]:
                self._end(env, Status.FORCE_LIMIT)
            elif missed[place] and (overlaps[place] or entered):
                self._end(env, Status.NOT_RESOLVED)
            else:
                current.keep(samples, place, len(self.path))
                if len(current.samples) == len(self.path):
                    self._end(env, Status.CONVERGED)
                elif len(current.samples) == self.press[env].steps:
                    self._end(env, Status.NO_ROOM)
        self.cost[:, environments], self._damping[environments] = 0, 0.0
