"""Levenberg-Marquardt damping of the tangent, which carries Newton's method past points where a press snaps.

Under an edge the gel may jump from one equilibrium to another. The tangent is then indefinite, or so ill conditioned
that its linear system is not solved, and Newton's method cycles. A viscous solid would slide past such a point. So the
tangent, but not the residual, gets the stress of a viscous increment, ::

    dP = eta mu / J  dF cof^T cof    (cof = cof F: eta mu / J times the Laplacian in the deformed shape)

Newton's method therefore converges to equilibrium of the elastic solid: damping changes the iterations, not their end
(pseudo-transient continuation, Kelley and Keyes, SIAM J. Numer. Anal. 35, 1998). The line search controls eta, as in
the method of Levenberg and Marquardt. If it cuts a step short, the linear model does not hold over the whole step, and
eta grows: the next step is shorter in soft directions. Whole steps let eta decay.
"""

from __future__ import annotations

import numpy as np

# eta: its first value; the value from which it does not grow; the value below which it counts as 0
INITIAL, MAX, NEGLIGIBLE = 0.5, 50.0, 0.05
DECAY = 0.7  # factor on eta after a whole step
SHORT_STEP = 0.5  # share of a step: if the line search takes less, eta doubles
STAGNATION_ONSET = 3  # iterations without a new least residual before an increment is damped
STAGNATION_LIMIT, MAX_ITERATIONS = 60, 160  # of a damped increment, which needs many iterations


class TangentDamping:
    """Damping ``eta`` (env,) of each environment's tangent, over mu. It is 0 until an increment stagnates."""

    def __init__(self, n_env: int):
        self.eta = np.zeros(n_env)
        self.used = np.zeros(n_env, dtype=bool)  # in the increment under way
        self._since_raised = np.zeros(n_env, dtype=np.int64)

    def begin(self, environments: np.ndarray):
        """Start an increment of the environments (env,) bool without damping."""
        self.eta[environments] = 0.0
        self.used[environments], self._since_raised[environments] = False, 0

    def can_increase(self, iterations: np.ndarray) -> np.ndarray:
        """Environments (env,) bool that may be damped more after these Newton iterations (env,)."""
        return (self.eta < MAX) & (iterations < MAX_ITERATIONS)

    def increase(self, environments: np.ndarray):
        """Double the damping of the environments (env,) bool."""
        self.eta[environments] = np.maximum(2.0 * self.eta, INITIAL)[environments]
        self._since_raised[environments] = 0
        self.used |= environments

    def adapt(self, taken: np.ndarray, share: np.ndarray, since_best: np.ndarray) -> np.ndarray:
        """Reduce the damping after whole steps and double it after short ones.

        taken (env,) bool: environments that took a step; share (env,): the share of it that they took; since_best
        (env,): iterations without a new least residual. Returns the environments (env,) bool that stagnate undamped.
        """
        short = taken & (share < SHORT_STEP)
        self.eta[short] = np.minimum(2.0 * self.eta, MAX)[short]
        self.eta[taken & (share == 1.0)] *= DECAY
        self.eta[taken & (self.eta < NEGLIGIBLE)] = 0.0
        self._since_raised[taken] += 1
        return taken & (self.eta == 0.0) & (since_best >= STAGNATION_ONSET) & (self._since_raised >= STAGNATION_ONSET)

    def limits(self, stagnation: int, iterations: int) -> tuple[np.ndarray, np.ndarray]:
        """Limits (env,) of iterations without progress and of all iterations; the given ones without damping."""
        return np.where(self.used, STAGNATION_LIMIT, stagnation), np.where(self.used, MAX_ITERATIONS, iterations)
