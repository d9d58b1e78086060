"""Least squares of measured forces: values, confidence intervals by profiles, and a test of one fit against another.

E enters linearly, so it is eliminated from every step (variable projection; Golub and Pereyra, SIAM J. Numer. Anal. 10,
1973). Intervals are those of the profile likelihood (Bates and Watts, *Nonlinear Regression Analysis*, 1988, section
6.1). For E alone they are the usual ones of Student's t distribution.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.optimize import brentq, least_squares
from scipy.stats import f as fisher
from scipy.stats import t as student

CONFIDENCE = 0.95
STARTS = 5  # values of each parameter from which the search may begin
SOLVED = 5e-4  # share of a force that the simulation's tolerances leave open; smaller residuals mean nothing
WIDEST = 1e4  # an interval of E ends within this factor, or not at all
E = "E"

Forces = Callable[[dict[str, float]], np.ndarray]  # (p,) N per Pa of E, from values of the free parameters


@dataclass(frozen=True)
class Interval:
    """A value with its confidence interval; an end is None where the data do not bound it within its limits."""

    value: float
    low: float | None
    high: float | None

    @property
    def is_determined(self) -> bool:
        return self.low is not None or self.high is not None


@dataclass(frozen=True)
class CurveFit:
    """Least-squares fit of forces.

    intervals : by name, E (Pa) first
    residual : (p,) simulated over measured force, minus 1
    squares : weighted sum of squares, at least that of `SOLVED`
    degrees : of freedom, points minus parameters
    is_absolute : sigma is the standard deviation itself, so that a scatter of 1 is what the measurement explains
    """

    intervals: dict[str, Interval]
    residual: np.ndarray
    squares: float
    degrees: int
    is_absolute: bool = False

    @property
    def scatter(self) -> float:
        """Standard deviation of a point, in units of its sigma; NaN without degrees of freedom."""
        return math.sqrt(self.squares / self.degrees) if self.degrees else math.nan

    @property
    def variance(self) -> float:
        """Variance of a point for intervals and tests, in units of sigma^2: at least 1 if sigma is absolute."""
        return max(self.scatter**2, 1.0) if self.is_absolute else self.scatter**2

    @property
    def values(self) -> dict[str, float]:
        return {name: each.value for name, each in self.intervals.items()}

    @property
    def rms(self) -> float:
        """Root mean square of the residual."""
        return float(np.sqrt((self.residual**2).mean()))


class LeastSquares:
    """The problem of a fit.

    measured, sigma : (p,) N; forces : simulated ones, by the free parameters
    limits : of the free parameters by name; is_absolute : sigma is the standard deviation itself, not up to a factor
    """

    def __init__(
        self,
        measured: np.ndarray,
        sigma: np.ndarray,
        forces: Forces,
        limits: dict[str, tuple[float, float]],
        is_absolute: bool = False,
    ):
        self.measured, self.sigma, self.forces, self.limits = measured, sigma, forces, limits
        self.is_absolute = is_absolute

    def fit(self) -> CurveFit:
        """Fit all free parameters."""
        best = self._minimise({}, self._starts())
        squares = self._squares(best)
        degrees = len(self.measured) - len(best)
        floor = float(((SOLVED * self.measured / self.sigma) ** 2).sum())
        squares_or_floor = max(squares, floor)
        residual = best[E] * self.forces(_others(best)) / self.measured - 1.0
        fit = CurveFit({}, residual, squares_or_floor, degrees, self.is_absolute)
        intervals = {name: self._interval(name, best, squares, fit) for name in best}
        return replace(fit, intervals=intervals)

    def modulus(self, values: dict[str, float]) -> float:
        """E with the least squares at values of the other parameters, Pa."""
        forces = self.forces(values) / self.sigma
        squared = forces @ forces
        return float(forces @ (self.measured / self.sigma) / squared) if squared else 0.0

    def _starts(self) -> list[dict[str, float]]:
        """Values over the whole range of each parameter; the best of them begins the search."""
        grids = [np.linspace(low, high, STARTS) for low, high in self.limits.values()]
        return [dict(zip(self.limits, map(float, values), strict=True)) for values in product(*grids)]

    def _minimise(self, fixed: dict[str, float], starts: Sequence[dict[str, float]]) -> dict[str, float]:
        """Values of all parameters with the least squares, some of them fixed; E first."""
        names = [name for name in self.limits if name not in fixed]

        def all_values(x: Sequence[float]) -> dict[str, float]:
            given = dict(zip(names, map(float, x), strict=True)) | fixed
            others = {name: given[name] for name in self.limits}
            return {E: fixed.get(E) or self.modulus(others), **others}

        def at(x: Sequence[float]) -> np.ndarray:
            return self._weighted(all_values(x))

        if not names:
            return all_values(())
        low, high = (np.array(each) for each in zip(*(self.limits[name] for name in names), strict=True))
        first = min(([start[name] for name in names] for start in starts), key=lambda x: float((at(x) ** 2).sum()))
        # "dogbox" reaches limits exactly, where a friction of 0 or an incompressible gel fits best.
        found = least_squares(at, np.clip(first, low, high), bounds=(low, high), method="dogbox", x_scale=high - low,
                              xtol=1e-10, ftol=1e-12, gtol=1e-12)  # fmt: skip
        return all_values(found.x)

    def _weighted(self, values: dict[str, float]) -> np.ndarray:
        return (values[E] * self.forces(_others(values)) - self.measured) / self.sigma

    def _squares(self, values: dict[str, float]) -> float:
        return float((self._weighted(values) ** 2).sum())

    def _interval(self, name: str, best: dict[str, float], squares: float, fit: CurveFit) -> Interval:
        """Interval where a fit with this value fixed is not significantly worse."""
        value = best[name]
        if not fit.degrees:
            return Interval(value, None, None)
        bound = squares + student.ppf(0.5 + 0.5 * CONFIDENCE, fit.degrees) ** 2 * fit.variance

        def excess(fixed: float) -> float:
            return self._squares(self._minimise({name: fixed}, [_others(best)])) - bound

        if name == E:  # its limits are factors, so the search for its ends goes by factors, too
            ends = (
                _crossing(lambda log: excess(value * math.exp(log)), 0.0, end * math.log(WIDEST)) for end in (-1, 1)
            )
            return Interval(value, *(None if end is None else value * math.exp(end) for end in ends))
        return Interval(value, *(_crossing(excess, value, limit) for limit in self.limits[name]))


def _crossing(excess: Callable[[float], float], inside: float, limit: float) -> float | None:
    """The value between ``inside`` and ``limit`` where ``excess`` becomes positive; None if it does not.

    The search for it begins near ``inside``, because the excess need not rise over all of a wide range.
    """
    step, last = 1e-3 * (limit - inside), inside
    while abs(step) < abs(limit - inside):
        if excess(inside + step) > 0.0:
            return float(brentq(excess, last, inside + step, rtol=1e-4, xtol=1e-9 * abs(limit - inside)))
        last, step = inside + step, 2.0 * step
    return float(brentq(excess, last, limit, rtol=1e-4)) if limit != inside and excess(limit) > 0.0 else None


def _others(values: dict[str, float]) -> dict[str, float]:
    return {name: value for name, value in values.items() if name != E}


def chance(fit: CurveFit, best: CurveFit, is_nested: bool) -> float:
    """Chance of such a difference if ``fit`` were as good as ``best``; small: the data tell them apart.

    It holds for two fits that were named beforehand; `simgen.calibration.material_fit` corrects for a best of many.

    is_nested : ``fit`` is ``best`` with fixed parameters. Then this is the F test of the extra sum of squares (Bates
        and Watts, section 3.10). Otherwise it is that of the ratio of variances. It takes the residuals of both fits as
        independent; they are alike, so it seldom tells two fits apart that the data cannot. NaN without degrees of
        freedom.
    """
    if not fit.degrees or not best.degrees:
        return math.nan
    if is_nested:
        extra = fit.degrees - best.degrees
        ratio = max(fit.squares - best.squares, 0.0) / extra / best.variance
        return float(fisher.sf(ratio, extra, best.degrees))
    return float(fisher.sf(fit.variance / best.variance, fit.degrees, best.degrees))
