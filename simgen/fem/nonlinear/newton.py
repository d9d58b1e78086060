"""Newton's method with updates of the contact multipliers, for many presses at once.

Each press is one *environment*: one column of every array.

Each iteration solves the linearised mixed system inexactly, steps with a line search, and updates the multipliers where
that helps. So displacements and multipliers converge together (a semismooth Newton method on the augmented Lagrangian;
Alart and Curnier 1991). Environments begin, converge and fail independently: each call of :meth:`NewtonSolver.iterate`
advances every environment by one iteration, or by one trial of its line search.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from simgen.config.solver_settings import SolverSettings
from simgen.fem import batch_arrays
from simgen.fem.contact.contact import Contact
from simgen.fem.elements.cavity import Cavity
from simgen.fem.elements.elasticity import Elasticity
from simgen.fem.nonlinear.damping import TangentDamping
from simgen.fem.nonlinear.force_balance import ForceBalance
from simgen.fem.nonlinear.increment import Increment
from simgen.fem.nonlinear.line_search import LineSearch
from simgen.fem.nonlinear.linear_systems import LinearSystems
from simgen.fem.nonlinear.status import Status

wp.set_module_options({"enable_backward": False})

SMALLEST_FORCE = 1e-6  # E mm2: smaller forces count as zero (1e-6 x 0.539 MPa mm2 = 0.5 uN)
# Multipliers are updated where the residual over the load is below this bound. Newton iterations of four cubes (to
# 0.4 mm, default mesh) are 180 without a bound and 169, 120, 120 and 153 with bounds of 1, 0.5, 0.2 and 0.02. Those of
# 18 smooth presses (to 2 mm, coarse mesh) are 1,307 without a bound, 1,331 with 0.5 and 1,355 with 0.2.
MULTIPLIER_UPDATE_RESIDUAL = 0.5
# Residual over the load from which an increment that looks early looks for inverted elements. Eight cubes to 2 mm on
# the DIGIT's default mesh take 1,808 Newton iterations if none looks early, 1,550 with 0.02 and 1,542 with 0.05.
EARLY_RESIDUAL = 0.02
REPEATABLE_ITERATIONS = 25  # Newton iterations; after more, an increment is not repeated for inverted elements
UPHILL_ITERATIONS = 3  # first Newton iterations of an increment, in which a step may go uphill
UNDAMPED_STAGNATION_LIMIT = 6  # iterations without a new least residual before an undamped increment fails


def per_component(fixed: np.ndarray) -> np.ndarray:
    """Fixed displacement components, (n, 3) bool, from fixed nodes (n,) or components (n, 3)."""
    return np.broadcast_to(fixed.reshape(len(fixed), -1), (len(fixed), 3))


class NewtonSolver:
    """Solves increments (load steps) of a body with its contacts and the fluid in its cavity, if there is one.

    ``fixed`` (node,) or (node, 3) bool marks fixed nodes or components. ``x`` (unknowns, env) are the states.
    Environments that are ``working`` (env,) bool have an increment under way.
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
        self.active = elasticity.active  # list that all kernels read
        self.n_unknowns = elasticity.n_displacements + elasticity.n_pressures + (cavity is not None)
        rows = np.zeros(self.n_unknowns, dtype=np.int32)
        rows[: elasticity.n_displacements] = per_component(fixed).ravel()
        self.fixed = wp.array(rows, dtype=wp.int32, device=elasticity.device)
        self.systems = LinearSystems(elasticity, contacts, cavity, self.fixed, settings)
        self.preconditioner, self._step = self.systems.preconditioner, self.systems.step
        self.x, self.trial = self.vector(), self.vector()
        self.balance = ForceBalance(elasticity, contacts, cavity, self.fixed, self._step)
        self.increment, self.working = Increment.empty(n_env), np.zeros(n_env, dtype=bool)
        self._at_guess = np.zeros(n_env, dtype=bool)  # ``trial`` is a guess, not a step from ``x``
        self._new_step = np.zeros(n_env, dtype=bool)  # ``trial`` is the end of a step that has not been judged yet
        self._looks_early = np.zeros(n_env, dtype=bool)  # the increment will still look for inverted elements
        self.damping, self._search = TangentDamping(n_env), LineSearch(n_env)
        self._residual_norm, self._best = np.zeros((2, n_env))
        self._since_best = np.zeros(n_env, dtype=np.int64)

    def vector(self):
        return wp.zeros((self.n_unknowns, self.n_env), dtype=wp.float64, device=self.elasticity.device)

    def mark(self, environments: np.ndarray):
        """Let kernels act in these environments (env,) bool; returns their list."""
        self.active.choose(environments)
        return self.active

    def abandon(self, environments: np.ndarray):
        """Stop the increments of the environments (env,) bool at their last state."""
        for flags in (self.working, self._at_guess, self._new_step, self._looks_early, self.systems.solving):
            flags &= ~environments

    @property
    def movable(self) -> np.ndarray:
        """Environments (env,) bool that can move: they have no factors and no linear system under way."""
        return ~(self.systems.solving | self.preconditioner.factored)

    def move(self, sources: np.ndarray, targets: np.ndarray):
        """Move increments from `movable` environments to others, given by number: (k,) each.

        Copies of an increment with a linear system under way are of use only after :meth:`abandon`.
        """
        records = (self.increment, self.damping, self._search)
        of_records = [values for record in records for values in vars(record).values()]
        flags = self.working, self._at_guess, self._new_step, self._looks_early
        for values in (*flags, self._residual_norm, self._best, self._since_best, *of_records):
            values[targets] = values[sources]
        self.systems.move(sources, targets)
        memory = [array for contact in self.contacts for array in contact.memory]
        moved = [self.x, self.trial, self.elasticity.weight, self.balance.step_sums, *memory]
        batch_arrays.move(moved, self.active, sources, targets)

    def reactions(self) -> np.ndarray:
        """Reactions (unknowns, env) at ``x``; in rows of pressures, the volume error, mm3."""
        self.mark(np.ones(self.n_env, dtype=bool))
        self.balance.measure(self.x)
        return self.balance.internal.numpy() + self.balance.surface.numpy()

    def solve(self, active: np.ndarray) -> Increment:
        """Find equilibrium from the guess ``self.x`` for the active environments (env,) bool.

        Call ``begin_increment`` of the contacts first.
        """
        wp.copy(self.trial, self.x)
        self.begin(active)
        while self.working.any():
            self.iterate()
        return self.increment

    def begin(self, environments: np.ndarray, looks_early: np.ndarray | None = None):
        """Start an increment of the environments (env,) bool from their guess in ``self.trial``.

        Call ``begin_increment`` of the contacts first. An increment that ``looks_early`` (env,) bool looks for inverted
        elements once, as soon as the residual is small. If there are any, it stabilises them and ends.
        """
        self._looks_early[environments] = False if looks_early is None else looks_early[environments]
        self.working |= environments
        self._at_guess |= environments
        self.increment.reset(environments)
        self._best[environments], self._since_best[environments] = np.inf, 0
        self.systems.distrust(environments)
        self.damping.begin(environments)

    def iterate(self) -> np.ndarray:
        """Advance all working environments; returns those (env,) bool that have ended, with ``increment.status``.

        An environment is in one of two states. Either it tests a step, and begins the next linear system if it accepts
        the step. Or it continues the linear system under way.
        """
        trying = self.working & ~self.systems.solving
        again, ended = self._try_steps(trying) if trying.any() else (trying, trying)
        solved, stalled, used = self.systems.advance(self.balance.residual)
        self.increment.krylov_iterations += used
        stalled &= ~self._solve_anew(stalled)
        self.increment.status[stalled] = Status.LINEAR_SOLVER_STALLED
        if solved.any():
            self.mark(solved)
            self.balance.measure_step()
            self._new_step |= solved
        if (again | solved).any():
            active = self.mark(again | solved)
            share = np.where(solved, 1.0, self._search.alpha)
            batch_arrays.add_scaled(self.x, self._step, -share, active, self.trial)
        ended = ended | stalled
        self.working &= ~ended
        return ended

    def _try_steps(self, trying: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Judge ``trial`` and begin linear systems where it is accepted.

        Returns the environments (env,) bool whose line search goes on, and those that have ended.
        """
        s, now = self.settings, self.increment
        self.mark(trying)
        measured = self.balance.measure(self.trial)
        new, self._new_step = self._new_step, np.zeros_like(self._new_step)
        self._search.begin(new, self._residual_norm, measured.work_at_start, measured.norms_at_start)
        trying = trying & ~self._refuse_uphill(new, measured.work_at_start)
        taken, again = self._search.judge(measured, self._at_guess, trying)
        lost = trying & ~taken & ~again
        stepped = taken & ~self._at_guess
        failed = lost & ~self._at_guess & self.damping.can_increase(now.newton_iterations)
        self._at_guess &= ~taken & ~lost
        batch_arrays.copy(self.trial, self.mark(taken), self.x)
        # No update far from equilibrium: it would preserve the error of a step. None either once the multipliers are
        # accurate enough, so that Newton's method ends with quadratic convergence.
        near = measured.residual_norm <= MULTIPLIER_UPDATE_RESIDUAL * np.maximum(measured.load_norm, SMALLEST_FORCE)
        unfinished = stepped & near & (measured.contact_error > s.contact_tolerance)
        if unfinished.any():
            self.mark(unfinished)
            for contact in self.contacts:
                contact.update_multipliers()
            measured = self.balance.measure_surfaces(self.x, measured, unfinished)
        relative = measured.residual_norm / np.maximum(measured.load_norm, SMALLEST_FORCE)
        now.residual[taken], now.contact_error[taken] = relative[taken], measured.contact_error[taken]
        now.min_det[taken] = measured.min_det[taken]
        balanced = np.maximum(relative, measured.imbalance) <= s.residual_tolerance
        done = taken & balanced & (measured.contact_error <= s.contact_tolerance)
        now.status[done] = Status.CONVERGED
        done |= self._stabilise_early(stepped & ~done & (relative <= EARLY_RESIDUAL))
        better = taken & (relative < 0.9 * self._best)
        self._best[better], self._since_best[better] = relative[better], 0
        self._since_best[taken & ~better] += 1
        damped = failed | ~done & self.damping.adapt(stepped, self._search.alpha, self._since_best)
        if damped.any():
            self._damp(damped)
        stagnation, most = self.damping.limits(UNDAMPED_STAGNATION_LIMIT, s.max_newton_iterations)
        hopeless = (self._since_best > stagnation) | (now.newton_iterations >= most)
        onwards = taken & ~done & ~hopeless & ~damped
        self._residual_norm[onwards] = measured.residual_norm[onwards]
        if onwards.any():
            self._begin_solving(onwards)
        return again, trying & ~onwards & ~again & ~damped

    def _stabilise_early(self, environments: np.ndarray) -> np.ndarray:
        """Stabilise elements that are inverted at ``x`` where increments look early; returns where there are any.

        environments (env,) bool: those with a small residual. Damped ones do not look, because `_damp` stabilises once.
        """
        looking = environments & self._looks_early & ~self.damping.used
        looking &= self.increment.newton_iterations <= REPEATABLE_ITERATIONS
        if looking.any():
            self._looks_early &= ~looking
            self.mark(looking)
            self.increment.inverted[looking] = self.elasticity.stabilise(self.x).read()[looking] > 0
        return looking & self.increment.inverted

    def _damp(self, environments: np.ndarray):
        """Damp the tangent more, and go on from the last accepted state.

        The first time in an increment, inverted elements are stabilised, because they may be the cause. Later times do
        not stabilise again, because each stabilisation can raise the residual 30-fold.
        """
        first = environments & ~self.damping.used
        self.damping.increase(environments)
        if first.any():
            self.mark(first)
            self.elasticity.stabilise(self.x)
        batch_arrays.copy(self.x, self.mark(environments), self.trial)
        self._at_guess |= environments

    def _refuse_uphill(self, new: np.ndarray, work: np.ndarray) -> np.ndarray:
        """Damp the tangent where it is indefinite along a new step; returns these environments (env,) bool.

        work (env,): virtual work of the residual along the step. If it is not positive, the step leads to a saddle or
        away from equilibrium. The sign says little in the first iterations, where volumes are still off, and where no
        force is left.
        """
        count = self.increment.newton_iterations
        uphill = new & (work <= 0.0) & (self._residual_norm > SMALLEST_FORCE) & (count > UPHILL_ITERATIONS)
        uphill &= self.damping.can_increase(count)
        if uphill.any():
            self._damp(uphill)
        return uphill

    def _begin_solving(self, environments: np.ndarray):
        """Begin linear systems at ``x``."""
        now, eta = self.increment, self.damping.eta
        now.newton_iterations[environments] += 1
        now.most_damping = np.maximum(now.most_damping, np.where(environments, eta, 0.0))
        self.systems.begin(environments, self.x, eta, self.balance.residual)

    def _solve_anew(self, stalled: np.ndarray) -> np.ndarray:
        """Restart linear systems that stalled (env,) bool: with a new multigrid or, if it is new, with more damping.

        Returns the environments (env,) bool that go on.
        """
        anew = stalled & self.damping.can_increase(self.increment.newton_iterations)
        if anew.any():
            damped = anew & self.systems.up_to_date
            self.systems.distrust(anew)
            if damped.any():
                self._damp(damped)
            if (anew & ~damped).any():
                self._begin_solving(anew & ~damped)
        return anew
