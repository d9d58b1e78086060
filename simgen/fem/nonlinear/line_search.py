"""Line search that bounds the residual and does not let the step's virtual work overshoot zero.

Friction makes the tangent jump between stick and slip, and full steps then cycle between two states. The virtual work
of the residual along the step changes sign in between (Crisfield's line search). Regula falsi finds the share of the
step where it does. If one end of the interval stays twice, its value is halved (the Illinois rule, Dowell and Jarratt,
BIT 11, 1971). Work that is rounding noise is ignored.
"""

from __future__ import annotations

import numpy as np

from simgen.fem.nonlinear.force_balance import StateMeasures

MAX_GROWTH = 10.0  # of the residual in one step
OVERSHOOT = 0.3  # share of the step's virtual work that may be left with the opposite sign
ROUNDING = 1e-13  # relative, of an inner product of forces and steps
MAX_TRIALS = 4  # beyond them more damping cuts the step short, see ``damping.py``


class LineSearch:
    """Line searches of all environments; arrays (env,). ``alpha`` is the share of the step that each tries next."""

    def __init__(self, n_env: int):
        self.alpha, self._size, self._work, self._noise = np.zeros((4, n_env))
        self._low, self._work_low = np.zeros((2, n_env))
        self._high, self._work_high = np.full((2, n_env), np.nan)
        self._trials = np.zeros(n_env, dtype=int)
        self._moved = np.zeros(n_env, dtype=int)  # the end of the interval that moved last: -1 low, 1 high

    def begin(self, environments: np.ndarray, size: np.ndarray, work: np.ndarray, norms: np.ndarray):
        """Start with whole steps in the environments (env,) bool, from residuals of the norm ``size`` (env,).

        work, norms (env,): the virtual work of the residual along the step, and the product of their norms.
        """
        on = environments
        self.alpha[on], self._low[on], self._high[on], self._trials[on] = 1.0, 0.0, np.nan, 0
        self._size[on], self._work[on], self._noise[on] = size[on], work[on], ROUNDING * norms[on]
        self._work_low[on], self._work_high[on], self._moved[on] = work[on], np.nan, 0

    def judge(self, tried: StateMeasures, guess: np.ndarray, working: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Accept states or choose another ``alpha``. Returns the environments (env,) bool that accept, and that go on.

        The other ``working`` searches have failed. ``guess`` (env,) bool marks guesses, which are accepted if their
        residual is finite.
        """
        usable = tried.residual_norm <= MAX_GROWTH * self._size
        allowed, bracketed = OVERSHOOT * self._work, usable & (self._work > self._noise)
        over = bracketed & (tried.work < -allowed)
        under = bracketed & (tried.work > allowed) & np.isfinite(self._high)
        self._trials += working & ~guess
        again = working & ~guess & (over | under | ~usable) & (self._trials < MAX_TRIALS)
        taken = working & ~again & np.where(guess, np.isfinite(tried.residual_norm), usable)
        over, under, broken = (again & each for each in (over, under, ~usable))
        self._work_low[over & (self._moved == 1)] *= 0.5
        self._work_high[under & (self._moved == -1)] *= 0.5
        self._moved = np.where(over, 1, np.where(under, -1, self._moved))
        self._high, self._work_high = np.where(over, [self.alpha, tried.work], [self._high, self._work_high])
        self._low, self._work_low = np.where(under, [self.alpha, tried.work], [self._low, self._work_low])
        with np.errstate(invalid="ignore", divide="ignore"):
            secant = np.clip(self._work_low / (self._work_low - self._work_high), 0.1, 0.9)
        between = self._low + (self._high - self._low) * secant
        self.alpha = np.where(over | under, between, np.where(broken, 0.5 * self.alpha, self.alpha))
        return taken, again
