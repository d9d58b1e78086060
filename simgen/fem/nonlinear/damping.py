"""Damping of the tangent, which carries Newton's method past points where a press snaps.

Under an edge the gel may jump from one equilibrium to another. There the tangent is indefinite, or so ill conditioned
that its linear system is not solved, and Newton's method cycles. A viscous solid would slide past such a point. So the
tangent, but not the residual, gets the stress of a viscous increment, ::

    dP = eta mu / J  dF cof^T cof    (cof = cof F: eta mu / J times the Laplacian in the deformed shape)

What converges is therefore equilibrium of the elastic solid: damping changes the way there, not the end (pseudo-
transient continuation, Kelley and Keyes, SIAM J. Numer. Anal. 35, 1998). The line search says whether there is enough
of it, as in the method of Levenberg and Marquardt: where a step has to be cut short, the model is good for less than
the step, and more damping makes the next one shorter in the directions that are soft. Whole steps need less.
"""

from __future__ import annotations

import numpy as np

FIRST, MOST, LEAST = 0.5, 50.0, 0.05  # eta: where it begins, where it is given up, what is nothing
FADE = 0.7  # of eta that is left after a whole step
SHORT = 0.5  # of a step: where less of it is taken, eta doubles
STUCK = 3  # iterations without a new least residual before an increment is damped
PATIENCE, ITERATIONS = 60, 160  # of a damped increment: it goes slowly


class Damping:
    """The damping ``eta`` (env,) of each environment's tangent, over mu. 0 until its increment gets stuck."""

    def __init__(self, n_env: int):
        self.eta = np.zeros(n_env)
        self.used = np.zeros(n_env, dtype=bool)  # in the increment under way
        self._since_raised = np.zeros(n_env, dtype=np.int64)

    def begin(self, environments: np.ndarray):
        """Start an increment of the environments (env,) bool without damping."""
        self.eta[environments] = 0.0
        self.used[environments], self._since_raised[environments] = False, 0

    def can_raise(self, iterations: np.ndarray) -> np.ndarray:
        """Tell which environments (env,) may be damped more after so many Newton iterations (env,)."""
        return (self.eta < MOST) & (iterations < ITERATIONS)

    def raise_(self, environments: np.ndarray):
        """Damp the environments (env,) bool twice as much."""
        self.eta[environments] = np.maximum(2.0 * self.eta, FIRST)[environments]
        self._since_raised[environments] = 0
        self.used |= environments

    def follow(self, taken: np.ndarray, share: np.ndarray, since_best: np.ndarray) -> np.ndarray:
        """Let the damping fade where a whole step was taken (env,) bool, or double it where a short one was.

        share (env,): of the step that was taken; since_best (env,): iterations without a new least residual. Returns
        which environments are stuck without damping.
        """
        short = taken & (share < SHORT)
        self.eta[short] = np.minimum(2.0 * self.eta, MOST)[short]
        self.eta[taken & (share == 1.0)] *= FADE
        self.eta[taken & (self.eta < LEAST)] = 0.0
        self._since_raised[taken] += 1
        return taken & (self.eta == 0.0) & (since_best >= STUCK) & (self._since_raised >= STUCK)

    def limits(self, patience: int, iterations: int) -> tuple[np.ndarray, np.ndarray]:
        """Patience and most Newton iterations (env,), where those without damping have the given ones."""
        return np.where(self.used, PATIENCE, patience), np.where(self.used, ITERATIONS, iterations)
