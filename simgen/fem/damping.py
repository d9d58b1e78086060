"""Damping of the tangent, which carries Newton's method past points where a press snaps.

Under an edge the gel may jump from one equilibrium to another. There the tangent is indefinite, or so ill conditioned
that its linear system is not solved, and Newton's method cycles. A viscous solid would slide past such a point. So the
tangent, but not the residual, gets the stress of a viscous increment, ::

    dP = eta mu / J  dF cof^T cof    (cof = cof F: eta mu / J times the Laplacian in the deformed shape)

What converges is therefore equilibrium of the elastic solid: damping changes the way there, not the end (pseudo-
transient continuation, Kelley and Keyes, SIAM J. Numer. Anal. 35, 1998).
"""

from __future__ import annotations

import numpy as np

FIRST, MOST, LEAST = 0.5, 50.0, 0.05  # eta: where it begins, where it is given up, what is nothing
FADE = 0.85  # of eta that is left after an iteration
WORSE = 3.0  # times the last residual: the damping was too little
STUCK = 3  # iterations without a new least residual before an increment is damped
PATIENCE, ITERATIONS = 60, 160  # of a damped increment: it goes slowly


class Damping:
    """The damping ``eta`` (env,) of each environment's tangent, over mu. 0 until its increment gets stuck."""

    def __init__(self, n_env: int):
        self.eta, self._last = np.zeros(n_env), np.full(n_env, np.inf)
        self.used = np.zeros(n_env, dtype=bool)  # in the increment under way
        self._since_raised = np.zeros(n_env, dtype=np.int64)

    def begin(self, environments: np.ndarray):
        """Start an increment of the environments (env,) bool without damping."""
        self.eta[environments], self._last[environments] = 0.0, np.inf
        self.used[environments], self._since_raised[environments] = False, 0

    def can_raise(self, iterations: np.ndarray) -> np.ndarray:
        """Tell which environments (env,) may be damped more after so many Newton iterations (env,)."""
        return (self.eta < MOST) & (iterations < ITERATIONS)

    def raise_(self, environments: np.ndarray):
        """Damp the environments (env,) bool twice as much."""
        self.eta[environments], self._last[environments] = np.maximum(2.0 * self.eta, FIRST)[environments], np.inf
        self._since_raised[environments] = 0
        self.used |= environments

    def follow(self, taken: np.ndarray, residual: np.ndarray, since_best: np.ndarray) -> np.ndarray:
        """Let the damping fade where a step was taken (env,) bool, or double it where the residual (env,) grew.

        since_best (env,): iterations without a new least residual. Returns which environments are stuck without it.
        """
        worse = taken & (self.eta > 0.0) & (residual > WORSE * self._last)
        self.eta[worse] *= 2.0
        self.eta[taken & ~worse] *= FADE
        self.eta[taken & (self.eta < LEAST)] = 0.0
        self._last[taken] = residual[taken]
        self._since_raised[taken] += 1
        return taken & (self.eta == 0.0) & (since_best >= STUCK) & (self._since_raised >= STUCK)

    def limits(self, patience: int, iterations: int) -> tuple[np.ndarray, np.ndarray]:
        """Patience and most Newton iterations (env,), where those without damping have the given ones."""
        return np.where(self.used, PATIENCE, patience), np.where(self.used, ITERATIONS, iterations)
