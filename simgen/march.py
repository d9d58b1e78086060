"""Presses on their way: each one has its own increments and its own next point to store; one that ends makes room.

The solver carries all of them on by an iteration at a time, and whichever has ended its increment begins the next one
at once. On a CPU the bytes of none depend on how many are under way together; on a GPU sums depend on its threads.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from .fem import columns
from .fem.status import Status
from .indenter_path import moved
from .scene import Scene

FURTHEST = 3.0  # of the last step, that a start may lie beyond: a short one says little of one that is much longer
CALM = 4  # increments that converge before a step that was halved is doubled: one that fails costs as much as four
MOST_OVERLAP = 0.25  # of a face's edge: beyond, the mesh does not resolve the contact
LEAST_OVERLAP_MM = 0.01  # that an indenter between the integration points shows before it counts as missed
NO_PRESS = -1
SECOND_TRY = 0.5  # of the steps of the first
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


class March:
    """The paths of the scene's b presses, of which ``scene.batch`` are under way, one in each environment.

    poses (b, 4, 4) mm at first touch; path (d, 4): offsets, mm, and turns about the press axis, rad; lateral (b,) mm:
    how far each indenter reaches from that axis; status (b,): those that have not converged there do not begin; the
    others do in this ``order`` (b,). A press ends after its ``steps`` (b,), and where its force along the press axis
    exceeds ``max_force_n``, which may be infinite.
    ``rows`` are the samples of each press with their ``status``, ``displacement`` (d, v, 3) m of each that has any,
    ``final`` how it ended.
    ``way`` is the length of path that lies behind an environment, mm.
    """

    def __init__(
        self, scene: Scene, poses: np.ndarray, path: np.ndarray, lateral: np.ndarray, status: np.ndarray,
        order: np.ndarray, steps: np.ndarray, max_force_n: float,
    ):  # fmt: skip
        self.scene, self.solver, self.path, self._poses, self._lateral = scene, scene.solver, path, poses, lateral
        self.rows: list[list[dict]] = [[] for _ in poses]
        self.displacement: list[np.ndarray | None] = [None for _ in poses]
        self._steps, self._max_force_n = steps, max_force_n
        self.final = np.where((status == Status.CONVERGED) & (steps == 0), Status.NO_ROOM, status)
        self._waiting = deque(order[self.final[order] == Status.CONVERGED])
        self._corners = np.vstack([np.zeros(4), path * [1.0, 1.0, 1.0, TURN_LEVER_MM]])
        lengths = np.linalg.norm(np.diff(self._corners, axis=0), axis=1)
        self._way_to = np.concatenate([[0.0], np.cumsum(lengths)])
        self._spacing = longest_of_leg(self._corners, lengths)
        batch = scene.batch
        self.press = np.full(batch, NO_PRESS)
        self.way, self.previous, self.target, self.step = np.zeros((4, batch))
        self._calm = np.zeros(batch, dtype=int)  # increments since one failed
        self._repeats = np.zeros(batch, dtype=int)  # of the increment under way
        self._damping = np.zeros(batch)  # largest since the last row
        self._reinforced = np.zeros(batch, dtype=bool)  # tried once more before it was given up
        self._failed: dict[int, tuple] = {}  # rows, displacement and status of each press whose first try failed
        self._share = np.ones(batch)  # of the longest steps that this try takes
        self.goal = np.zeros(batch)
        self.spacing = np.full(batch, self._spacing[0])  # of the leg under way
        self.cost = np.zeros((3, batch), dtype=np.int64)  # Newton, Krylov iterations and sub-steps since the last row
        self.x_start, self.x_previous = self.solver.vector(), self.solver.vector()
        self._now = np.tile(np.eye(4), (batch, 1, 1))  # poses at the end of the increments under way

    def to_the_end(self):
        self._begin(self._load())
        while (self.press != NO_PRESS).any():
            ended = self.solver.iterate()
            if ended.any():
                ended &= ~self._solve_again(ended)
                self._settle(ended)
                self._begin((ended | self._load()) & (self.press != NO_PRESS))

    def _load(self) -> np.ndarray:
        """Presses that wait into environments that are free; returns which (env,) these are."""
        fresh = np.zeros(self.scene.batch, dtype=bool)
        free = np.flatnonzero(self.press == NO_PRESS)[: len(self._waiting)]
        if not len(free):
            return fresh
        self.press[free] = [self._waiting.popleft() for _ in free]
        for array in (self.way, self.previous, self.cost.T, self._repeats, self._damping):
            array[free] = 0
        self._calm[free] = CALM
        self._reinforced[free] = False
        self._share[free] = [SECOND_TRY if press in self._failed else 1.0 for press in self.press[free]]
        self.step[free] = self.spacing[free] = self._share[free] * self._spacing[0]
        fresh[free] = True
        self.scene.load(fresh, np.maximum(self.press, 0))
        return fresh

    def _place(self, way: np.ndarray) -> np.ndarray:
        """The places (env, 4) mm of the indenters on their path: offsets from first touch, and turns as lengths."""
        return np.stack([np.interp(way, self._way_to, self._corners[:, i]) for i in range(4)], axis=-1)

    def _pose(self, way: np.ndarray) -> np.ndarray:
        place = self._place(way)
        return moved(self._poses[self.press], place[:, :3], place[:, 3] / TURN_LEVER_MM)

    def _begin(self, starting: np.ndarray):
        """The next increment in the environments (env,) bool.

        Its guess goes on from the last two states, displacements and multipliers, as far as the path goes on along
        their line. It also says where points enter contact.
        """
        if not starting.any():
            return
        solver = self.solver
        stored = np.array([len(self.rows[press]) if press != NO_PRESS else 0 for press in self.press])
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
        columns.copy(solver.x, marked, self.x_start)
        columns.go_beyond(self.x_previous, self.x_start, onwards, marked, solver.trial)
        for x in (self.x_start, solver.trial):
            solver.elasticity.expect(x)
        self._now[starting] = self._pose(self.target)[starting]
        at_rest = np.tile(np.eye(4), (self.scene.batch, 1, 1))
        # No point of an indenter moves further: the tip's way, and an arc at the rim.
        travel = np.linalg.norm(now[:, :3], axis=1) + self._lateral[self.press] * np.abs(now[:, 3]) / TURN_LEVER_MM
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
        solved once more from its start; elements that are inside out are then accepted. Where faces still overlap the
        indenter too far, the increment has failed.
        """
        solver, out = self.solver, self.solver.increment
        converged = ended & (out.status == Status.CONVERGED)
        asked = converged & (self._repeats < MOST_REPEATS)
        again = np.zeros_like(ended)
        if asked.any():
            solver.mark(asked)
            again = asked & (solver.elasticity.stabilise(solver.x) > 0)
        due = converged & (self.target == self.goal)
        if due.any():
            solver.mark(due)
            too_far = due & (self.scene.samples.overlap()[1] > MOST_OVERLAP)
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
            columns.copy(solver.x, solver.mark(again), solver.trial)
            solver.begin(again)
        return again

    def _count_cost(self, ended: np.ndarray):
        out = self.solver.increment
        self.cost[:2, ended] += np.stack([out.newton_iterations, out.krylov_iterations])[:, ended]
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
            columns.copy(self.x_start, marked, solver.x)
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
            hopeless = failed & (self.step < least)
            once_more = hopeless & ~self._reinforced
            if once_more.any():
                solver.elasticity.reinforce(solver.mark(once_more))
                self._reinforced |= once_more
                self.step[once_more] = self.spacing[once_more]
            for env in np.flatnonzero(hopeless & ~once_more):
                self._fail(env, out.status[env])
        marked = solver.mark(converged)
        columns.copy(self.x_start, marked, self.x_previous)
        for contact in solver.contacts:
            contact.keep(marked)
        self.previous[converged] = self.way[converged]
        self.way[converged] = self.target[converged]
        self._calm[converged] += 1
        longer = converged & (self._calm >= CALM)
        self.step[longer] = np.minimum(2.0 * self.step, self.spacing)[longer]
        self._store(converged & (self.target == self.goal))

    def _fail(self, env: int, status: int):
        """Press once more from rest what has failed for the first time. Then keep the try that got further."""
        press = self.press[env]
        rows, displacement = self.rows[press], self.displacement[press]
        if press not in self._failed:
            self._failed[press] = rows, displacement, status
            self.rows[press], self.displacement[press] = [], None
            self._waiting.appendleft(press)
            self.press[env] = NO_PRESS
            return
        if len(self._failed[press][0]) > len(rows):
            self.rows[press], self.displacement[press], status = self._failed[press]
        self._end(env, status)

    def _end(self, env: int, status: int):
        self.final[self.press[env]] = status
        self.press[env] = NO_PRESS

    def _store(self, reached: np.ndarray):
        """Keep the samples of the environments that have just reached a point to store."""
        if not reached.any():
            return
        out = self.solver.increment
        for env, sample in self.scene.samples.take(reached):
            press = self.press[env]
            rows, displacement = self.rows[press], sample.pop("displacement")
            overlap = sample.pop("overlap_mm")
            if abs(sample["force"] @ self._poses[press][:3, 1]) > self._max_force_n:
                self._end(env, Status.FORCE_LIMIT)
                continue
            entered = not rows and self.path[0, 1] > LEAST_OVERLAP_MM
            missed = not sample["force"].any() and (entered or overlap > LEAST_OVERLAP_MM)
            if missed:
                self._end(env, Status.NOT_RESOLVED)
                continue
            if not rows:
                self.displacement[press] = np.empty((len(self.path), *displacement.shape), displacement.dtype)
            self.displacement[press][len(rows)] = displacement
            costs = dict(zip(("newton_iterations", "krylov_iterations", "substeps"), self.cost[:, env], strict=True))
            solved = {name: getattr(out, name)[env] for name in ("residual", "contact_error")}
            status = Status.INSIDE_OUT if sample["inverted_elements"] else Status.CONVERGED
            solved |= {"min_det_F": out.min_det[env], "damping": self._damping[env], "status": status}
            rows.append(sample | costs | solved)
            self.cost[:, env], self._damping[env] = 0, 0.0
            if len(rows) == len(self.path):
                self._end(env, Status.CONVERGED)
            elif len(rows) == self._steps[press]:
                self._end(env, Status.NO_ROOM)
