"""Linearised systems of Newton's method, one for each environment, solved inexactly by preconditioned iterations."""

from __future__ import annotations

import numpy as np
import warp as wp

from simgen.fem import batch_arrays
from simgen.fem.batch_arrays import Envs, Indices, SingleVectors
from simgen.fem.linear_solver.krylov import ConjugateResiduals
from simgen.fem.linear_solver.krylov_kernels import STRICT_ITERATIONS
from simgen.fem.linear_solver.preconditioner import BlockTriangular

wp.set_module_options({"enable_backward": False})

# Factor on the linear tolerance after `STRICT_ITERATIONS`. Without it, the slowest environment of a batch takes twice
# as many Krylov iterations as the mean. It leaves Newton iterations the same on the DIGIT, and adds 9 % on the BioTac.
LOOSE_FACTOR = 3.0
# Krylov iterations of a batch before solved environments take their Newton step: on a GPU most are solved after four.
# 1,024 presses on one H200, DIGIT and BioTac: 17.0 and 21.2 s; with five 17.7 and 21.8, with six 18.2 and 21.8.
KRYLOV_PER_ROUND = 4
# The same for at most `FEW_SYSTEMS` systems, because rounds of few mostly wait for the host. Solved ones stop after
# `KRYLOV_PER_ROUND`. 8 and 40 cubes alone take 4.29 and 7.34 s, instead of 4.62 and 7.74 (one H200 each, once).
KRYLOV_PER_ROUND_OF_FEW = 12
FEW_SYSTEMS = 8
# On a CPU, a solved system leaves the round at once, and after a short round it is back sooner with the next one. So
# more of eight environments are at work: 0.77 s a depth instead of 0.82 with four iterations (16 presses on the default
# DIGIT, 8 at once, to 0.5 mm; both at the same time on two cores, once).
KRYLOV_PER_CPU_ROUND = 2
# Least damping with which a sparse factor replaces multigrid. Factors on the DIGIT's default mesh take 8 s of a core,
# and damped multigrid mostly serves: a ring's first step of 0.25 mm takes 12 s, and 64 s with factors first.
FACTOR_DAMPING = 2.0


@wp.kernel
def clear_rows_kernel(rows: Indices, active: Envs, action_out: SingleVectors):
    i, lane = wp.tid()
    env = active[lane]
    if env >= 0:
        action_out[rows[i], env] = 0.0


class LinearSystems:
    """Tangent, preconditioner and Krylov solver of all environments.

    ``fixed`` (unknowns,) int32 marks fixed rows. ``step`` (unknowns, env) receives the solutions. Environments that are
    ``solving`` (env,) have a system under way.
    """

    def __init__(self, elasticity, contacts: list, cavity, fixed: wp.array, settings):
        self.elasticity, self.active, self.size = elasticity, elasticity.active, settings.krylov_size
        self.surface_terms = contacts if cavity is None else [*contacts, cavity]
        n_env, device = len(self.active), elasticity.device
        self._fixed_rows = wp.array(np.flatnonzero(fixed.numpy()), dtype=wp.int32, device=device)
        self.preconditioner = BlockTriangular(elasticity, contacts, cavity, fixed, self._add_tangent)
        self.krylov = ConjugateResiduals(len(fixed), self.size, device, self.active)
        self.step = wp.zeros((len(fixed), n_env), dtype=wp.float64, device=device)
        self.tolerance, self.loose_tolerance = settings.linear_tolerance, LOOSE_FACTOR * settings.linear_tolerance
        # A batch does not wait for its slowest linear system.
        cpu = wp.get_device(device).is_cpu
        self._per_round = self.size if n_env == 1 else KRYLOV_PER_CPU_ROUND if cpu else KRYLOV_PER_ROUND
        self._solve_together = n_env > 1 and not cpu
        self.solving, self._rebuilt = np.zeros((2, n_env), dtype=bool)  # _rebuilt: multigrid is of this state
        self._last_iterations = np.zeros(n_env, dtype=np.int64)
        self._damping = np.zeros(n_env)

    def _add_tangent(self, v, out, reduced: bool):
        self.elasticity.tangent(v, out, reduced)
        for term in self.surface_terms:
            term.tangent(v, out)
        batch_arrays.launch(clear_rows_kernel, len(self._fixed_rows), [self._fixed_rows, self.active], [out])

    def _tangent(self, v, out):
        batch_arrays.reset(self.active, out)
        self._add_tangent(v, out, reduced=False)

    def distrust(self, environments: np.ndarray):
        """Rebuild multigrid at the next linearisation of the environments (env,) bool."""
        self._last_iterations[environments] = self.size

    @property
    def up_to_date(self) -> np.ndarray:
        """Environments (env,) bool where a new preconditioner of the same linearisation would be no better."""
        return self._rebuilt | self.preconditioner.factored

    def move(self, sources: np.ndarray, targets: np.ndarray):
        """Move solved systems, with their multigrid, from environments to others, given by number: (k,) each."""
        self.preconditioner.forget(np.isin(np.arange(len(self.solving)), targets))  # factors of an earlier press
        for values in (self.solving, self._rebuilt, self._last_iterations, self._damping):
            values[targets] = values[sources]
        batch_arrays.move([self.step], self.active, sources, targets)
        self.preconditioner.multigrid.move(sources, targets)

    def begin(self, environments: np.ndarray, x, damping: np.ndarray, residual):
        """Linearise at x and begin the systems of the environments (env,) bool, with the tangent's damping (env,)."""
        self.solving |= environments
        self._damping[environments] = damping[environments]
        self.active.choose(environments)
        self.elasticity.damp(damping)
        self.elasticity.linearize(x)
        for term in self.surface_terms:
            term.linearize(x)
        # Multigrid is kept while it serves: rebuilding costs two thirds of one application.
        allowed = self._per_round if self._solve_together else STRICT_ITERATIONS
        stale = environments & ~self.preconditioner.factored & (self._last_iterations > allowed)
        self._rebuilt[environments] = stale[environments]
        if stale.any():
            self.active.choose(stale)
            self.preconditioner.rebuild_multigrid()
        self._prepare(environments & ~self.preconditioner.factored, residual, factored=False)

    def _prepare(self, environments: np.ndarray, residual, factored: bool) -> np.ndarray:
        """Prepare preconditioners and begin Krylov iterations; returns the singular environments (env,) bool."""
        singular = np.zeros(len(environments), dtype=bool)
        if environments.any():
            self.active.choose(environments)
            wanted = np.flatnonzero(environments)
            singular[self.preconditioner.prepare(wanted, self._last_iterations, factored)] = True
            self.active.choose(environments & ~singular)
            self.krylov.begin(residual)
        return singular

    def advance(self, residual) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Advance the systems under way. Returns the environments (env,) bool that are solved, and that stalled.

        Also returns the iterations (env,) of the systems that ended, otherwise 0.
        """
        factored, used = self.preconditioner.factored, np.zeros_like(self._last_iterations)
        wanted = self.solving & ~factored
        solved, missed = self._iterate(wanted, self._most(wanted), False, used)
        hopeless = missed & self._rebuilt & (self._damping >= FACTOR_DAMPING)
        missed &= ~self.preconditioner.switch_to_factors(hopeless)
        by_factor = self.solving & factored
        if by_factor.any():
            singular = self._prepare(by_factor, residual, factored=True)
            also, stalled = self._iterate(by_factor & ~singular, self.size, True, used)
            solved, missed = solved | also, missed | stalled | singular
        self.solving &= ~(solved | missed)
        return solved, missed, used

    def _most(self, wanted: np.ndarray) -> int:
        """Number of Krylov iterations that the ``wanted`` systems (env,) bool may take in a round."""
        few = self._solve_together and np.count_nonzero(wanted) <= FEW_SYSTEMS
        return KRYLOV_PER_ROUND_OF_FEW if few else self._per_round

    def _iterate(self, wanted: np.ndarray, most: int, factored: bool, used: np.ndarray):
        """Iterate the ``wanted`` systems (env,) bool, by at most ``most`` iterations.

        Returns the environments (env,) bool that are solved, and that missed their tolerance. Adds the iterations of
        the systems that ended to ``used`` (env,).
        """
        if not wanted.any():
            return wanted, wanted
        self.active.choose(wanted)
        self.preconditioner.select(factored)
        terms = self._tangent, self.preconditioner.apply, self.tolerance, self.loose_tolerance
        together = KRYLOV_PER_ROUND if self._solve_together and not factored else 0
        ended = wanted & ~self.krylov.advance(*terms, most, together, capture=not factored)
        if not ended.any():
            return ended, ended
        self.active.choose(ended)
        iterations, relative = self.krylov.end(self.step)
        used[ended] += iterations[ended]
        self._last_iterations[ended] = iterations[ended]
        missed = ended & ~(relative <= self.loose_tolerance)
        return ended & ~missed, missed
