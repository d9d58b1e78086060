"""Newton's method with contact multipliers updated as it goes, in many environments that each go their own way.

Every iteration solves the linearised mixed system inexactly, steps with a line search, and then updates the
multipliers, so that both converge together (a semismooth Newton method on the augmented Lagrangian; Alart and Curnier
1991). Environments begin, converge and fail independently: :meth:`NewtonSolver.iterate` carries each one on by an
iteration, or by one more trial of its line search.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from simgen.config.solver_settings import SolverSettings
from simgen.fem import batch_arrays
from simgen.fem.contact.contact import Contact
from simgen.fem.elements.cavity import Cavity
from simgen.fem.elements.elasticity import Elasticity
from simgen.fem.linear_solver.krylov import ConjugateResiduals
from simgen.fem.linear_solver.krylov_kernels import SOON
from simgen.fem.linear_solver.preconditioner import BlockTriangular
from simgen.fem.nonlinear.damping import Damping
from simgen.fem.nonlinear.force_balance import Balance
from simgen.fem.nonlinear.line_search import LineSearch
from simgen.fem.nonlinear.status import Status

wp.set_module_options({"enable_backward": False})


@wp.kernel
def hold_kernel(
    rows: wp.array(dtype=wp.int32),
    active: wp.array(dtype=wp.int32),
    # outputs
    action_out: wp.array2d(dtype=wp.float32),
):
    i, lane = wp.tid()
    env = active[lane]
    if env >= 0:
        action_out[rows[i], env] = 0.0


SMALLEST_FORCE = 1e-6  # in units of E mm2: forces below are nothing (1e-6 x 0.539 MPa mm2 = 0.5 uN)
# Of the linear tolerance, from the fourth iteration on. Without, the slowest environment of a batch takes twice as many
# iterations as a mean one; Newton's method takes none more for it on the DIGIT, 9 % more on the BioTac.
LOOSER = 3.0
# Iterations of all linear systems of a batch, before those that are solved go on: on a GPU most are after four, and
# those that were earlier have saved Newton iterations by then. 1,024 presses on one H200, DIGIT and BioTac: 17.0 and
# 21.2 s; with five 17.7 and 21.8, with six 18.2 and 21.8.
KRYLOV_AT_ONCE = 4
# Out-of-balance forces over the load, at which multipliers begin to follow. Newton iterations of four cubes to 0.4 mm
# on the default mesh, and of 18 smooth presses to 2 mm on the coarse one: without this bound 180 and 1,307; with 1 169;
# with 0.5 120 and 1,331; with 0.2 120 and 1,355; with 0.02 153.
NEAR_BALANCE = 0.5
EARLY = 3  # Newton iterations in which a step may go uphill
PATIENCE = 6  # iterations without a new least residual before an increment is given up (and halved)


def per_component(fixed: np.ndarray) -> np.ndarray:
    """Which displacement components are zero, (n, 3) bool, from whole nodes (n,) or components (n, 3)."""
    return np.broadcast_to(fixed.reshape(len(fixed), -1), (len(fixed), 3))


@dataclass
class Increment:
    """What an increment has cost so far and where it is; arrays (env,). ``status`` says how those that ended did."""

    status: np.ndarray
    residual: np.ndarray
    contact_error: np.ndarray
    min_det: np.ndarray
    newton_iterations: np.ndarray
    krylov_iterations: np.ndarray
    most_damping: np.ndarray

    @classmethod
    def empty(cls, n_env: int) -> Increment:
        return cls(np.full(n_env, Status.NEWTON_STALLED), *np.full((3, n_env), np.inf),
                   *np.zeros((2, n_env), dtype=np.int64), np.zeros(n_env))  # fmt: skip


class NewtonSolver:
    """Solves increments of a body with its contacts and the fluid in its cavity, if there is one.

    ``fixed`` (node,) or (node, 3) marks what does not move. ``x`` (unknowns, env) are the states; environments that are
    ``working`` (env,) are on their way to the end of an increment.
    """

    def __init__(
        self,
        elasticity: Elasticity,
        contacts: list[Contact],
        fixed,
        n_env: int,
        settings: SolverSettings,
        cavity: Cavity | None = None,
    ):
        self.elasticity, self.contacts, self.settings, self.n_env = elasticity, contacts, settings, n_env
        self.cavity = cavity
        self.surface_terms = contacts if cavity is None else [*contacts, cavity]
        self.active = elasticity.active  # list that all kernels read
        device = elasticity.device
        self.n_unknowns = elasticity.n_displacements + elasticity.n_pressures + (cavity is not None)
        rows = np.zeros(self.n_unknowns, dtype=np.int32)
        fixed = per_component(fixed)
        rows[: elasticity.n_displacements] = fixed.ravel()
        self.fixed = wp.array(rows, dtype=wp.int32, device=device)
        self._held_rows = wp.array(np.flatnonzero(rows), dtype=wp.int32, device=device)
        self.preconditioner = BlockTriangular(elasticity, contacts, cavity, self.fixed, self._add_tangent)
        self.krylov = ConjugateResiduals(self.n_unknowns, settings.krylov_size, device, self.active)
        self.x, self.trial, self._step = (self.vector() for _ in range(3))
        self.balance = Balance(elasticity, contacts, cavity, self.fixed, self._step)
        self.increment, self.working = Increment.empty(n_env), np.zeros(n_env, dtype=bool)
        self._first, self._solving, self._fresh = np.zeros((3, n_env), dtype=bool)  # _fresh: cycles of this state
        self.damping = Damping(n_env)
        self._search, self._size = LineSearch(n_env), np.zeros(n_env)
        # A press alone waits for itself. A batch does not wait for its slowest linear system.
        self._at_once = settings.krylov_size if n_env == 1 else KRYLOV_AT_ONCE
        self._together = n_env > 1 and not wp.get_device(device).is_cpu
        self._best = np.zeros(n_env)
        self._since_best, self._last_krylov = np.zeros((2, n_env), dtype=np.int64)

    def vector(self):
        return wp.zeros((self.n_unknowns, self.n_env), dtype=wp.float64, device=self.elasticity.device)

    def mark(self, environments: np.ndarray):
        """Let kernels act in these environments (env,) bool; returns their list."""
        self.active.choose(environments)
        return self.active

    def _add_tangent(self, v, out, rough: bool):
        self.elasticity.tangent(v, out, rough)
        for term in self.surface_terms:
            term.tangent(v, out)
        batch_arrays.launch(hold_kernel, len(self._held_rows), [self._held_rows, self.active], [out])

    def _tangent(self, v, out):
        batch_arrays.reset(self.active, out)
        self._add_tangent(v, out, rough=False)

    def abandon(self, environments: np.ndarray):
        """Leave the increments of the environments (env,) bool where they are: they are not on their way any more."""
        for now in (self.working, self._first, self._solving):
            now &= ~environments

    def reactions(self) -> np.ndarray:
        """Forces (unknowns, env) that hold the body at ``x``; rows of pressures say what their volumes lack, mm3."""
        self.mark(np.ones(self.n_env, dtype=bool))
        self.balance.measure(self.x)
        return self.balance.internal.numpy() + self.balance.surface.numpy()

    def solve(self, active: np.ndarray) -> Increment:
        """Find equilibrium from the guess ``self.x`` for the active environments (env,) bool.

        The contacts have been told of the increment by ``begin_increment``.
        """
        wp.copy(self.trial, self.x)
        self.begin(active)
        while self.working.any():
            self.iterate()
        return self.increment

    def begin(self, environments: np.ndarray):
        """Start an increment of the environments (env,) bool from their guess in ``self.trial``.

        The contacts have been told by ``begin_increment``.
        """
        self.working |= environments
        self._first |= environments
        fresh, now = Increment.empty(self.n_env), self.increment
        for name, values in vars(fresh).items():
            setattr(now, name, np.where(environments, values, getattr(now, name)))
        self._best[environments], self._since_best[environments] = np.inf, 0
        self._last_krylov[environments] = self.settings.krylov_size
        self.damping.begin(environments)

    def iterate(self) -> np.ndarray:
        """Carry on all working environments; returns those (env,) bool that have ended, by ``increment.status``.

        An environment either tries a step and, where it takes it, starts on the next linear system, or goes on with
        that system's solution.
        """
        trying = self.working & ~self._solving
        again, ended = self._try_steps(trying) if trying.any() else (trying, trying)
        solved, stalled = self._go_on_solving()
        stalled &= ~self._solve_anew(stalled)
        self.increment.status[stalled] = Status.LINEAR_SOLVER_STALLED
        if solved.any():
            self.mark(solved)
            work = self.balance.work()
            self._search.begin(solved, self._size, work)
            solved &= ~self._refuse_uphill(solved, work[0])
        if (again | solved).any():
            marked = self.mark(again | solved)
            batch_arrays.go_along(self.x, self._step, -self._search.alpha, marked, self.trial)
        ended = ended | stalled
        self.working &= ~ended
        return ended

    def _try_steps(self, trying: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Judge ``trial``, begin linear systems where it is taken. Returns (env,): searches that go on, what ended."""
        s, now = self.settings, self.increment
        self.mark(trying)
        measured = self.balance.measure(self.trial)
        taken, again = self._search.judge(measured, self._first, trying)
        lost = trying & ~taken & ~again
        stepped = taken & ~self._first
        failed = lost & ~self._first & self.damping.can_raise(now.newton_iterations)
        self._first &= ~taken & ~lost
        batch_arrays.copy(self.trial, self.mark(taken), self.x)
        # Multipliers rest far from balance, where an update would carry on what a step got wrong, and once they are
        # good enough, so that Newton's method ends with quadratic convergence.
        near = measured.size <= NEAR_BALANCE * np.maximum(measured.load, SMALLEST_FORCE)
        unfinished = stepped & near & (measured.contact_error > s.contact_tolerance)
        if unfinished.any():
            self.mark(unfinished)
            for contact in self.contacts:
                contact.update_multipliers()
            measured = self.balance.measure_surfaces(self.x, measured, unfinished)
        relative = measured.size / np.maximum(measured.load, SMALLEST_FORCE)
        now.residual[taken], now.contact_error[taken] = relative[taken], measured.contact_error[taken]
        now.min_det[taken] = measured.min_det[taken]
        balanced = np.maximum(relative, measured.imbalance) <= s.residual_tolerance
        done = taken & balanced & (measured.contact_error <= s.contact_tolerance)
        now.status[done] = Status.CONVERGED
        better = taken & (relative < 0.9 * self._best)
        self._best[better], self._since_best[better] = relative[better], 0
        self._since_best[taken & ~better] += 1
        damped = failed | ~done & self.damping.follow(stepped, self._search.alpha, self._since_best)
        if damped.any():
            self._damp(damped)
        patience, most = self.damping.limits(PATIENCE, s.max_newton_iterations)
        hopeless = (self._since_best > patience) | (now.newton_iterations >= most)
        onwards = taken & ~done & ~hopeless & ~damped
        self._size[onwards] = measured.size[onwards]
        if onwards.any():
            self._begin_solving(onwards)
        return again, trying & ~onwards & ~again & ~damped

    def _damp(self, environments: np.ndarray):
        """Damp the tangent more, and go on from the state that was taken last.

        Where damping begins, elements that are inside out are stabilised: they are what the increment got stuck at.
        """
        begins = environments & (self.damping.eta == 0.0)
        self.damping.raise_(environments)
        if begins.any():
            self.mark(begins)
            self.elasticity.stabilise(self.x)
        batch_arrays.copy(self.x, self.mark(environments), self.trial)
        self._first |= environments

    def _refuse_uphill(self, solved: np.ndarray, work: np.ndarray) -> np.ndarray:
        """Damp the tangent where it is indefinite along the step that was solved for; returns where (env,) it is.

        work (env,): the forces' virtual work along the step. One that is not positive leads to a saddle, or away. In
        the first iterations volumes are still off, and its sign says little, as it does where there is no force left.
        """
        now = self.increment.newton_iterations
        uphill = solved & (work <= 0.0) & (self._size > SMALLEST_FORCE) & (now > EARLY) & self.damping.can_raise(now)
        if uphill.any():
            self._damp(uphill)
        return uphill

    def _begin_solving(self, environments: np.ndarray):
        """Start on Newton directions at ``x``."""
        self._solving |= environments
        self.mark(environments)
        self.increment.newton_iterations[environments] += 1
        self.increment.most_damping = np.maximum(
            self.increment.most_damping, np.where(environments, self.damping.eta, 0.0)
        )
        self.elasticity.damp(self.damping.eta)
        self.elasticity.linearize(self.x)
        for term in self.surface_terms:
            term.linearize(self.x)
        # A cycle is kept while it serves: to make one costs two thirds of a use.
        most = self._at_once if self._together else SOON
        stale = environments & ~self.preconditioner.factored & (self._last_krylov > most)
        self._fresh[environments] = stale[environments]
        if stale.any():
            self.mark(stale)
            self.preconditioner.follow()
        self._prepare(environments & ~self.preconditioner.factored, factored=False)

    def _prepare(self, environments: np.ndarray, factored: bool) -> np.ndarray:
        """Get preconditioners ready and begin the linear systems; returns those (env,) that are singular."""
        singular = np.zeros(self.n_env, dtype=bool)
        if environments.any():
            self.mark(environments)
            singular[self.preconditioner.update(np.flatnonzero(environments), self._last_krylov, factored)] = True
            self.mark(environments & ~singular)
            self.krylov.begin(self.balance.residual)
        return singular

    def _go_on_solving(self) -> tuple[np.ndarray, np.ndarray]:
        """Iterations of the linear systems under way; returns which (env,) are solved, with ``_step``, and stalled."""
        factored = self.preconditioner.factored
        solved, missed = self._krylov_iterations(self._solving & ~factored, self._at_once, factored=False)
        missed &= ~self.preconditioner.fall_back(missed & self._fresh)
        by_factor = self._solving & factored
        if by_factor.any():
            singular = self._prepare(by_factor, factored=True)
            also, stalled = self._krylov_iterations(by_factor & ~singular, self.settings.krylov_size, factored=True)
            solved, missed = solved | also, missed | stalled | singular
        self._solving &= ~(solved | missed)
        return solved, missed

    def _solve_anew(self, stalled: np.ndarray) -> np.ndarray:
        """Begin once more on linear systems that were not solved: with a new cycle, or with more damping.

        Returns which (env,) of the ``stalled`` ones go on.
        """
        anew = stalled & self.damping.can_raise(self.increment.newton_iterations)
        if anew.any():
            damped = anew & (self._fresh | self.preconditioner.factored)
            self._last_krylov[anew] = self.settings.krylov_size
            if damped.any():
                self._damp(damped)
            if (anew & ~damped).any():
                self._begin_solving(anew & ~damped)
        return anew

    def _krylov_iterations(self, wanted: np.ndarray, most: int, factored: bool) -> tuple[np.ndarray, np.ndarray]:
        """Carry the wanted systems (env,) on; returns which are solved and which have missed their tolerance."""
        if not wanted.any():
            return wanted, wanted
        self.mark(wanted)
        self.preconditioner.use(factored)
        tolerance, later = self.settings.linear_tolerance, LOOSER * self.settings.linear_tolerance
        terms = self._tangent, self.preconditioner.apply, tolerance, later
        together = self._together and not factored
        finished = wanted & ~self.krylov.go_on(*terms, most, together, capture=not factored)
        if not finished.any():
            return finished, finished
        self.mark(finished)
        used, relative = self.krylov.end(self._step)
        self.increment.krylov_iterations[finished] += used[finished]
        self._last_krylov[finished] = used[finished]
        missed = finished & ~(relative <= later)
        return finished & ~missed, missed
