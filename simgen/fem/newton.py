"""One load increment: Newton's method with contact multipliers updated as it goes.

Every iteration solves the linearised mixed system inexactly, steps with a line search that keeps det F positive, and
then updates the multipliers, so that both converge together (a semismooth Newton method on the augmented Lagrangian;
Alart and Curnier 1991). Environments converge, fail and stop independently.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
import warp as wp

from .cavity import Cavity
from .contact import Contact
from .krylov import ConjugateResiduals, combine, dots, norms
from .operator import Elasticity
from .preconditioner import BlockTriangular

wp.set_module_options({"enable_backward": False})


class Status(IntEnum):
    """Outcome of a press at one depth; ``sentence`` says what it means and what to try."""

    CONVERGED = 0
    NEWTON_STALLED = 1
    INVERTED = 2
    LINEAR_SOLVER_STALLED = 3
    NEVER_TOUCHES = 4
    STARTS_INSIDE = 5
    NOT_RESOLVED = 6

    @property
    def sentence(self) -> str:
        return _SENTENCES[self]


_SENTENCES = {
    Status.CONVERGED: "Converged: residual and contact constraint are within the job's tolerances.",
    Status.NEWTON_STALLED: "Newton's method did not converge even in the smallest sub-step; try a finer mesh, or less "
    "friction.",
    Status.INVERTED: "An element would turn inside out even in the smallest sub-step; try a finer mesh or a smaller "
    "depth.",
    Status.LINEAR_SOLVER_STALLED: "The linear solver did not reach its tolerance even in the smallest sub-step; try a "
    "larger krylov_size.",
    Status.NEVER_TOUCHES: "The indenter does not meet the touchable surface along its axis; check its pose.",
    Status.NOT_RESOLVED: "The mesh does not resolve the contact: the surface overlaps the indenter or the core by too "
    "much of a face; try a finer mesh, or a smaller depth.",
    Status.STARTS_INSIDE: "The indenter already overlaps the sensor where it starts; start it further away.",
}


@dataclass(frozen=True)
class SolverSettings:
    """Tolerances and constants of the solver.

    residual_tolerance : out-of-balance forces over contact forces (Euclidean norms over nodes)
    contact_tolerance : change that a further multiplier update would make, over the multipliers (L2 norms)
    linear_tolerance : residual of the linear solve over the out-of-balance forces; single precision reaches 1e-5
    volumetric_split : gamma / mu, the part of the bulk stiffness that acts pointwise (see material.py)
    contact_stiffness, friction_stiffness : k edge / E of the augmented Lagrangian, edge of each face (see traction.py)
    max_newton_iterations : per increment; an increment that needs more is halved
    smallest_substep : least increment, as a share of the distance between stored depths
    krylov_size : most iterations of one linear solve
    """

    residual_tolerance: float = 1e-4
    contact_tolerance: float = 5e-3
    linear_tolerance: float = 5e-2
    volumetric_split: float = 1.0
    contact_stiffness: float = 20.0
    friction_stiffness: float = 20.0
    max_newton_iterations: int = 25
    smallest_substep: float = 1.0 / 64.0
    krylov_size: int = 80


SMALLEST_FORCE = 1e-6  # in units of E mm2: forces below are nothing (1e-6 x 0.539 MPa mm2 = 0.5 uN)
SMALLEST_MULTIPLIERS = 1e-6  # the same for the L2 norm of the contact multipliers, E mm: a contact that opens
LEAST_DETERMINANT = 0.05  # det F below which a step counts as inverted
MOST_GROWTH = 10.0  # of the out-of-balance forces in one step
OVERSHOOT = 0.3  # of the step's virtual work that may be left with the opposite sign
ROUNDING = 1e-13  # relative, of an inner product of forces and steps
MOST_TRIALS = 8
PATIENCE = 6  # iterations without a new least residual before an increment is given up (and halved)


@wp.kernel
def hold_kernel(
    held: wp.array(dtype=wp.int32),
    # outputs
    residual_out: wp.array2d(dtype=Any),
):
    i, env = wp.tid()
    if held[i] == 1:
        residual_out[i, env] = residual_out.dtype(0.0)


def per_component(held: np.ndarray) -> np.ndarray:
    """Which displacement components are zero, (n, 3) bool, from whole nodes (n,) or components (n, 3)."""
    return np.broadcast_to(held.reshape(len(held), -1), (len(held), 3))


@dataclass
class Increment:
    """What one increment cost and where it ended; arrays (env,)."""

    status: np.ndarray
    residual: np.ndarray
    contact_error: np.ndarray
    min_det: np.ndarray
    newton_iterations: np.ndarray
    krylov_iterations: np.ndarray


class NewtonSolver:
    """Solves increments of a body with its contacts and the liquid in its cavity, if there is one.

    ``held`` (node,) or (node, 3) marks what does not move.
    """

    def __init__(
        self,
        elasticity: Elasticity,
        contacts: list[Contact],
        held,
        n_env: int,
        settings: SolverSettings,
        cavity: Cavity | None = None,
    ):
        self.elasticity, self.contacts, self.settings, self.n_env = elasticity, contacts, settings, n_env
        self.cavity = cavity
        self.surface_terms = contacts if cavity is None else [*contacts, cavity]
        self.active = elasticity.active  # device flags that all kernels read
        device = elasticity.device
        self.n_unknowns = elasticity.n_displacements + elasticity.n_pressures + (cavity is not None)
        rows = np.zeros(self.n_unknowns, dtype=np.int32)
        held = per_component(held)
        rows[: elasticity.n_displacements] = held.ravel()
        self.held = wp.array(rows, dtype=wp.int32, device=device)
        self.preconditioner = BlockTriangular(elasticity, contacts, cavity, self.held, self._tangent)
        self.krylov = ConjugateResiduals(self.n_unknowns, settings.krylov_size, device, self.active)
        self.x, self._trial, self._residual, self._step = (self.vector() for _ in range(4))

    def vector(self):
        return wp.zeros((self.n_unknowns, self.n_env), dtype=wp.float64, device=self.elasticity.device)

    def forces(self, x, hold: bool = True):
        """Out-of-balance forces at x into the work vector; returns it, norms of the loads and least det F.

        Loads are the forces of the contacts and of the liquid.
        """
        r = self._residual
        r.zero_()
        for term in self.surface_terms:
            term.residual(x, r)
        load = norms(r[: self.elasticity.n_displacements])
        min_det = wp.full(self.n_env, np.inf, dtype=wp.float64, device=r.device)
        self.elasticity.residual(x, r, min_det)
        if hold:
            wp.launch(hold_kernel, dim=r.shape, inputs=[self.held], outputs=[r], device=r.device)
        return r, load, min_det.numpy()

    def _tangent(self, v, out):
        out.zero_()
        self.elasticity.tangent(v, out)
        for term in self.surface_terms:
            term.tangent(v, out)
        wp.launch(hold_kernel, dim=out.shape, inputs=[self.held], outputs=[out], device=out.device)

    def _linear_solve(self, r, active: np.ndarray):
        """Newton direction into ``self._step``; returns the iterations and which environments stalled."""
        self.elasticity.linearize(self.x)
        for term in self.surface_terms:
            term.linearize(self.x)
        used, missed = self._krylov(r, active)
        if missed.any() and self.preconditioner.fall_back():
            self._last_krylov[:] = self.settings.krylov_size
            again, missed = self._krylov(r, active)
            used += again
        return used, missed

    def _krylov(self, r, active: np.ndarray):
        """Solve the linearised system with the preconditioner of this state, as ``_linear_solve``."""
        tolerance = self.settings.linear_tolerance
        self.active.assign(active.astype(np.int32))
        singular = np.zeros(self.n_env, dtype=bool)
        singular[self.preconditioner.update(np.flatnonzero(active), self._last_krylov)] = True
        if singular.any():
            self.active.assign((active & ~singular).astype(np.int32))
        used, relative = self.krylov.solve(self._tangent, self.preconditioner.apply, r, self._step, tolerance)
        self.active.assign(active.astype(np.int32))
        self._last_krylov = np.where(active, used, self._last_krylov)
        return used, active & (singular | ~(relative <= tolerance))

    def update_multipliers(self, write: bool) -> np.ndarray:
        """Relative change (env,) of all multipliers in an update, which is carried out if ``write``."""
        change, size = np.zeros((2, self.n_env))
        for contact in self.contacts:
            c, n = contact.update_multipliers(self.x, write)
            change, size = np.hypot(change, c), np.hypot(size, n)
        return change / np.maximum(size, SMALLEST_MULTIPLIERS)

    def solve(self, active: np.ndarray) -> Increment:
        """Find equilibrium from the guess ``self.x`` for the active environments (env,) bool.

        The contacts have been told of the increment by ``begin_increment``.
        """
        s = self.settings
        running = active.copy()
        out = Increment(np.full(self.n_env, Status.NEWTON_STALLED), *np.full((3, self.n_env), np.inf),
                        *np.zeros((2, self.n_env), dtype=np.int64))  # fmt: skip
        self._last_krylov = np.full(self.n_env, s.krylov_size)
        best, since_best = np.full(self.n_env, np.inf), np.zeros(self.n_env, dtype=int)
        for _ in range(s.max_newton_iterations + 1):
            self.active.assign(running.astype(np.int32))
            r, load, min_det = self.forces(self.x)
            scale = np.maximum(load, SMALLEST_FORCE)
            size = norms(r)
            error = self.update_multipliers(write=False)
            relative = size / scale
            out.residual[running], out.contact_error[running] = relative[running], error[running]
            out.min_det[running] = min_det[running]
            bad = running & ~(min_det > LEAST_DETERMINANT)
            out.status[bad] = Status.INVERTED
            done = running & ~bad & (relative <= s.residual_tolerance) & (error <= s.contact_tolerance)
            out.status[done] = Status.CONVERGED
            better = relative < 0.9 * best
            best, since_best = np.where(better, relative, best), np.where(better, 0, since_best + 1)
            hopeful = (since_best <= PATIENCE) & (out.newton_iterations < s.max_newton_iterations)
            running = running & ~done & ~bad & hopeful
            if not running.any():
                break
            self.active.assign(running.astype(np.int32))
            used, stalled = self._linear_solve(r, running)
            out.krylov_iterations += used
            out.newton_iterations[running] += 1
            out.status[stalled] = Status.LINEAR_SOLVER_STALLED
            running &= ~stalled
            accepted = self._line_search(size, running)
            inverted = running & ~accepted & ~(self._trial_det > LEAST_DETERMINANT)
            out.status[inverted] = Status.INVERTED
            running &= accepted
            # Multipliers that are good enough rest, so that Newton's method ends with quadratic convergence.
            unfinished = running & (self.update_multipliers(write=False) > s.contact_tolerance)
            self.active.assign(unfinished.astype(np.int32))
            self.update_multipliers(write=True)
        self.active.assign(active.astype(np.int32))
        return out

    def _line_search(self, size: np.ndarray, running: np.ndarray) -> np.ndarray:
        """x -= alpha step: det F stays positive, forces bounded, and the step's virtual work does not overshoot zero.

        Friction makes the tangent jump between stick and slip, and full steps then cycle between two states; the
        virtual work of the out-of-balance forces along the step changes sign in between (Crisfield's line search).
        Work that is nothing but rounding says nothing. Returns which environments found a step.
        """
        work = self._work(self._residual)
        noise = ROUNDING * norms(self._residual) * norms(self._step)
        alpha, low, high = np.where(running, 1.0, 0.0), np.zeros(self.n_env), np.full(self.n_env, np.nan)
        work_low, work_high = work.copy(), np.full(self.n_env, np.nan)
        allowed = OVERSHOOT * work
        usable = np.zeros(self.n_env, dtype=bool)
        for _ in range(MOST_TRIALS):
            wp.copy(self._trial, self.x)
            combine(self._step, -alpha, self._trial)
            r, _, min_det = self.forces(self._trial)
            self._trial_det = min_det
            usable = (min_det > LEAST_DETERMINANT) & (norms(r) <= MOST_GROWTH * size)
            now = self._work(r)
            bracketed = usable & (work > noise)
            over = running & bracketed & (now < -allowed)
            under = running & bracketed & (now > allowed) & np.isfinite(high)
            broken = running & ~usable
            if not (over | under | broken).any():
                break
            high, work_high = np.where(over, alpha, high), np.where(over, now, work_high)
            low, work_low = np.where(under, alpha, low), np.where(under, now, work_low)
            with np.errstate(invalid="ignore", divide="ignore"):
                secant = np.clip(work_low / (work_low - work_high), 0.1, 0.9)
            alpha = np.where(over | under, low + (high - low) * secant, np.where(broken, 0.5 * alpha, alpha))
        wp.copy(self.x, self._trial)
        return usable | ~running

    def _work(self, r) -> np.ndarray:
        """Virtual work (env,) of forces r along the Newton step."""
        n_u = self.elasticity.n_displacements
        return dots(r[:n_u], self._step[:n_u])
