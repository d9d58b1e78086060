"""Presses on their way: each one has its own increments and its own next point to store; one that ends makes room.

The solver carries all of them on by an iteration at a time, and whichever has ended its increment begins the next one
at once. On a CPU the bytes of none depend on how many are under way together; on a GPU sums depend on its threads.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable

import numpy as np

from simgen.config.indenter_path import moved
from simgen.fem import batch_arrays
from simgen.fem.nonlinear.status import Status
from simgen.simulation.measurements import Solution, take_samples
from simgen.simulation.press_queue import PressQueue
from simgen.simulation.scene import Scene
from simgen.simulation.state_sampler import StateSampler
from simgen.simulation.tries import DOUBT, Press, Try

LONGEST_MM = 0.25  # of a load step: with friction the force depends on the way, also where few depths are stored
FURTHEST = 3.0  # of the last step, that a start may lie beyond: a short one says little of one that is much longer
CALM = 4  # increments that converge before a step that was halved is doubled: one that fails costs as much as four
MOST_OVERLAP = 0.25  # of a face's edge: beyond, the mesh does not resolve the contact
LEAST_OVERLAP_MM = 0.01  # that an indenter between the integration points shows before it counts as missed
EASY = 25  # Newton iterations: an increment that took more is not solved again for elements that are inside out
# Newton iterations since the last sample, after which an increment that fails ends the try. Of the 619,193 samples that
# two runs of the paired job made (8a88ef0, 5c68dee; one H200) none took more than 951.
MOST_ITERATIONS = 1000
MOST_REPEATS = 8  # of an increment whose state has elements inside out, or overlaps the indenter too far
TURN_LEVER_MM = 5.0  # a turn counts as long as the way of a point so far from the press axis: half an indenter's width


def longest_of_leg(corners: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """The length (d,) of the longest segment of each segment's leg: of those before and after it in one direction.

    corners (d + 1, c): the path; lengths (d,): of its segments.
    """
    directions = np.diff(corners, axis=0) / np.maximum(lengths, 1e-12)[:, None]
    turns = (directions[1:] * directions[:-1]).sum(axis=1) < 1.0 - 1e-9
    leg = np.concatenate([[0], np.cumsum(turns)])
    longest = np.zeros(leg[-1] + 1)
    np.maximum.at(longest, leg, lengths)
    return longest[leg]


class LoadStepping:
    """Presses along one path, of which ``scene.batch`` are under way at a time, one in each environment.

    path (d, 4): offsets, mm, and turns about the press axis, rad. A press ends after its steps, and where its force
    along the press axis exceeds ``max_force_n``, which may be infinite. The scene has the shapes.
    ``way`` is the length of path that lies behind an environment, mm.
    """

    _counted = 0.0  # s, until when the time of all load stepping has been shared out

    def __init__(self, scene: Scene, path: np.ndarray, max_force_n: float):
        self.scene, self.solver, self.path, self._max_force_n = scene, scene.solver, path, max_force_n
        self.sampler, self._waiting = StateSampler.of(scene), PressQueue()
        self._corners = np.vstack([np.zeros(4), path * [1.0, 1.0, 1.0, TURN_LEVER_MM]])
        lengths = np.linalg.norm(np.diff(self._corners, axis=0), axis=1)
        self._way_to = np.concatenate([[0.0], np.cumsum(lengths)])
        self._spacing = np.minimum(longest_of_leg(self._corners, lengths), LONGEST_MM)
        batch = scene.batch
        self.press: list[Press | None] = [None] * batch
        self.tries: list[Try | None] = [None] * batch
        self.at_work, self._next = np.zeros((2, batch), dtype=bool)  # has a try; begins its next increment
        self._shape, self._poses, self._lateral = np.zeros(batch), np.tile(np.eye(4), (batch, 1, 1)), np.zeros(batch)
        self.way, self.previous, self.target, self.step = np.zeros((4, batch))
        self._calm = np.zeros(batch, dtype=int)  # increments since one failed
        self._repeats = np.zeros(batch, dtype=int)  # of the increment under way
        self._damping = np.zeros(batch)  # largest since the last row
        self._reinforced = np.zeros(batch, dtype=bool)  # tried once more before it was given up
        self._share = np.ones(batch)  # of the longest steps that this try takes
        self.goal = np.zeros(batch)
        self.spacing = np.full(batch, self._spacing[0])  # of the leg under way
        self._spent = np.zeros(batch, dtype=np.int64)  # Newton iterations of this try
        self.cost = np.zeros((3, batch), dtype=np.int64)  # Newton, Krylov iterations and sub-steps since the last row
        self.x_start, self.x_previous = self.solver.vector(), self.solver.vector()
        self._now = np.tile(np.eye(4), (batch, 1, 1))  # poses at the end of the increments under way

    def add(self, presses: Iterable[Press]):
        """Let presses wait for environments that become free."""
        for press in presses:
            if press.status is None and press.steps == 0:
                press.status = Status.NO_ROOM
            if press.status is None:
                self._waiting.add(press)

    def drop(self, presses: Collection[Press]):
        """Forget presses that nobody waits for any more."""
        for press in presses:
            press.dropped = True
        self._waiting.remove_dropped()
        self._free(np.array([press is not None and press.dropped for press in self.press]))

    @property
    def unfinished(self) -> list[Press]:
        return [*self._waiting, *(press for press in self.press if press is not None)]

    @property
    def left(self) -> int:
        """Presses that wait, and tries that are under way."""
        return len(self._waiting) + int(self.at_work.sum())

    @property
    def busy(self) -> int:
        """Environments that will be at work."""
        return min(self.left, self.scene.batch)

    def go_on(self):
        """Carry on what is under way by an iteration."""
        begin = time.perf_counter()
        self._begin(self._next | self._load())
        self._next[:] = False
        under_way = [press for press in self.press if press is not None]
        ended = self.solver.iterate()
        if ended.any():
            ended &= ~self._solve_again(ended)
            self._settle(ended)
            self._next = ended & self.at_work
        # Marches of two threads overlap: time counts once, for the one that ends first.
        now = time.perf_counter()
        begin, LoadStepping._counted = max(begin, LoadStepping._counted), now
        for press in under_way:
            press.seconds += (now - begin) / len(under_way)

    def _load(self) -> np.ndarray:
        """Begin tries in environments that are free; returns which (env,) these are."""
        fresh = np.zeros(self.scene.batch, dtype=bool)
        free = np.flatnonzero(~self.at_work)
        if not len(free):
            return fresh
        doubted = [self.press[env] for env in np.flatnonzero(self.at_work & (self.cost[0] > DOUBT))]
        doubted = [press for press in doubted if len(press.tries) == 1]
        for env in free[: len(doubted) + len(self._waiting)]:
            press = doubted.pop() if doubted else self._waiting.pop()
            self.press[env], self.tries[env] = press, press.next_try()
            self._shape[env], self._poses[env], self._lateral[env] = press.shape, press.pose, press.lateral
            self._share[env] = self.tries[env].share
            fresh[env] = True
        if not fresh.any():
            return fresh
        self.at_work |= fresh
        for array in (self.way, self.previous, self.cost.T, self._spent, self._repeats, self._damping):
            array[fresh] = 0
        self._calm[fresh] = CALM
        self._reinforced[fresh] = False
        self.step[fresh] = self.spacing[fresh] = self._share[fresh] * self._spacing[0]
        self.scene.load(fresh, self._shape)
        return fresh

    def _place(self, way: np.ndarray) -> np.ndarray:
        """The places (env, 4) mm of the indenters on their path: offsets from first touch, and turns as lengths."""
        return np.stack([np.interp(way, self._way_to, self._corners[:, i]) for i in range(4)], axis=-1)

    def _pose(self, way: np.ndarray) -> np.ndarray:
        place = self._place(way)
        return moved(self._poses, place[:, :3], place[:, 3] / TURN_LEVER_MM)

    def _begin(self, starting: np.ndarray):
        """The next increment in the environments (env,) bool.

        Its guess goes on from the last two states, displacements and multipliers, as far as the path goes on along
        their line. It also says where points enter contact.
        """
        if not starting.any():
            return
        solver = self.solver
        stored = np.array([0 if each is None else len(each.samples) for each in self.tries])
        segment = np.minimum(stored, len(self.path) - 1)
        self.goal = self._way_to[1 + segment]
        spacing = self._share * self._spacing[segment]
        self.step = np.where(spacing != self.spacing, spacing, self.step)
        self.spacing = spacing
        target = np.minimum(self.way + self.step, self.goal)
        self.target = np.where(starting, np.where(self.goal - target < 1e-9, self.goal, target), self.target)
        here = self._place(self.way)
        last, now = here - self._place(self.previous), self._place(self.target) - here
        length = (last**2).sum(axis=-1)
        onwards = (last * now).sum(axis=-1) / np.where(length > 0.0, length, np.inf)
        onwards = np.clip(onwards, 0.0, FURTHEST)
        marked = solver.mark(starting)
        batch_arrays.copy(solver.x, marked, self.x_start)
        batch_arrays.extrapolate(self.x_previous, self.x_start, onwards, marked, solver.trial)
        for x in (self.x_start, solver.trial):
            solver.elasticity.expect(x)
        self._now[starting] = self._pose(self.target)[starting]
        at_rest = np.tile(np.eye(4), (self.scene.batch, 1, 1))
        # No point of an indenter moves further: the tip's way, and an arc at the rim.
        travel = np.linalg.norm(now[:, :3], axis=1) + self._lateral * np.abs(now[:, 3]) / TURN_LEVER_MM
        before = self._pose(self.way)
        self.scene.indenter_contact.begin_increment(self.x_start, solver.trial, before, self._now, travel)
        for contact in self.scene.fixed_contacts:
            contact.begin_increment(self.x_start, solver.trial, at_rest, at_rest, travel)
        for contact in solver.contacts:
            contact.extrapolate(onwards)
        solver.begin(starting)

    def _solve_again(self, ended: np.ndarray) -> np.ndarray:
        """Solve increments again that have converged to a state that cannot be kept.

        Elements that are inside out are stabilised more, and where a sample is due, faces that overlap the indenter too
        far are stiffened. Returns which (env,) of those that ``ended`` go on. One that does not converge again is
        solved once more from its start; elements that are inside out are then accepted, as they are where the increment
        was not `EASY`. Where stiffer faces do not help, or no skin is left before the core, the increment has failed.
        """
        solver, out = self.solver, self.solver.increment
        converged = ended & (out.status == Status.CONVERGED)
        asked = converged & (self._repeats < MOST_REPEATS)
        again = asked & (out.newton_iterations <= EASY)
        if again.any():
            solver.mark(again)
            again &= solver.elasticity.stabilise(solver.x) > 0
        due = converged & (self.target == self.goal)
        if due.any():
            solver.mark(due)
            sampler = self.sampler
            too_far = due & ((sampler.overlap()[1] > MOST_OVERLAP) | (sampler.room() < 0.0))
            out.status[too_far & ~asked] = Status.NOT_RESOLVED
            too_far &= asked
            if too_far.any():
                solver.mark(too_far)
                for contact in solver.contacts:
                    contact.stiffen(solver.x)
                again |= too_far
        if again.any():
            self._repeats[again] += 1
            self._count_cost(again)
            batch_arrays.copy(solver.x, solver.mark(again), solver.trial)
            solver.begin(again)
        return again

    def _count_cost(self, ended: np.ndarray):
        out = self.solver.increment
        self.cost[:2, ended] += np.stack([out.newton_iterations, out.krylov_iterations])[:, ended]
        self._spent[ended] += out.newton_iterations[ended]
        self._damping[ended] = np.maximum(self._damping, out.most_damping)[ended]

    def _settle(self, ended: np.ndarray):
        """Keep or take back the increments that have ended."""
        solver, out = self.solver, self.solver.increment
        self._count_cost(ended)
        self.cost[2, ended] += 1
        converged = ended & (out.status == Status.CONVERGED)
        failed = ended & ~converged
        if failed.any():  # back to where they began
            marked = solver.mark(failed)
            batch_arrays.copy(self.x_start, marked, solver.x)
            for contact in solver.contacts:
                contact.restore(marked)
        unchecked = failed & (self._repeats > 0) & (self._repeats <= MOST_REPEATS)
        unchecked &= out.status != Status.NOT_RESOLVED
        self._repeats[ended] = np.where(unchecked, MOST_REPEATS + 1, 0)[ended]
        failed &= ~unchecked
        if failed.any():
            self.step[failed], self._calm[failed] = (self.target - self.way)[failed] / 2.0, 0
            # A leg of few long steps may be cut as finely as the press.
            least = self.scene.settings.smallest_substep * np.minimum(self.spacing / self._share, self._spacing[0])
            worn_out = failed & (self.cost[0] > MOST_ITERATIONS)
            once_more = failed & (self.step < least) & ~worn_out & ~self._reinforced
            hopeless = failed & (self.step < least) & ~once_more | worn_out
            if once_more.any():
                solver.elasticity.reinforce(solver.mark(once_more))
                self._reinforced |= once_more
                self.step[once_more] = self.spacing[once_more]
            for env in np.flatnonzero(hopeless):
                self._end(env, out.status[env], failed=True)
        marked = solver.mark(converged)
        batch_arrays.copy(self.x_start, marked, self.x_previous)
        for contact in solver.contacts:
            contact.keep(marked)
        self.previous[converged] = self.way[converged]
        self.way[converged] = self.target[converged]
        self._calm[converged] += 1
        longer = converged & (self._calm >= CALM)
        self.step[longer] = np.minimum(2.0 * self.step, self.spacing)[longer]
        self._store(converged & (self.target == self.goal))

    def _end(self, env: int, status: int, failed: bool = False):
        """End a try. The press ends with it, or goes on with another one."""
        press, ended = self.press[env], self.tries[env]
        ended.status, ended.failed = status, failed
        self._waiting.learn(press.shape, self._spent[env])
        press.settle()
        if press.status is None and len(press.tries) == 1:
            self._waiting.add(press)
        if press.status is None:
            self._free(np.arange(self.scene.batch) == env)
        else:  # with its other try, if that is under way
            self._free(np.array([each is press for each in self.press]))

    def _free(self, environments: np.ndarray):
        """Take the tries from the environments (env,) bool, wherever they are."""
        for env in np.flatnonzero(environments):
            self.press[env] = self.tries[env] = None
        self.at_work &= ~environments
        self._next &= ~environments
        self.solver.abandon(environments)

    def _store(self, reached: np.ndarray):
        """Keep the samples of the environments that have just reached a point to store."""
        if not reached.any():
            return
        out = self.solver.increment
        solution = Solution(out.residual, out.contact_error, out.min_det, self._damping, *self.cost)
        for env, sample in take_samples(self.sampler, reached, self._poses, solution):
            if (current := self.tries[env]) is None:  # the press has just ended with its other try
                continue
            press, force = self.press[env], sample.values["force"]
            if abs(force @ press.pose[:3, 1]) > self._max_force_n:
                self._end(env, Status.FORCE_LIMIT)
                continue
            entered = not current.samples and self.path[0, 1] > LEAST_OVERLAP_MM
            missed = not force.any() and (entered or sample.overlap_mm > LEAST_OVERLAP_MM)
            if missed:
                self._end(env, Status.NOT_RESOLVED)
                continue
            current.keep(sample, len(self.path))
            self.cost[:, env], self._damping[env] = 0, 0.0
            if len(current.samples) == len(self.path):
                self._end(env, Status.CONVERGED)
            elif len(current.samples) == press.steps:
                self._end(env, Status.NO_ROOM)
