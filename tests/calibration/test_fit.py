"""Least squares on force curves by formula: known values come back, and intervals cover them as often as they say."""

import numpy as np
import pytest
from scipy.stats import t as student

from simgen.calibration.fit import CONFIDENCE, LeastSquares, chance

DEPTH = np.linspace(0.25, 2.0, 8)
BOUNDS = {"offset": (-0.2, 0.2), "power": (1.2, 2.2)}
TRUE = {"offset": 0.04, "power": 1.6}
E = 4e5


def forces(values):
    depth = np.maximum(DEPTH + values.get("offset", 0.0), 0.0)
    return 1e-5 * depth ** values.get("power", 1.6)


def problem(measured, *free, sigma=None, is_absolute=False):
    bounds = {name: BOUNDS[name] for name in free}
    return LeastSquares(measured, measured if sigma is None else sigma, forces, bounds, is_absolute)


def test_exact_forces_give_their_values_back():
    fit = problem(E * forces(TRUE), "offset", "power").fit()
    for name, value in {"E": E, **TRUE}.items():
        found = fit.intervals[name]
        assert found.value == pytest.approx(value, rel=1e-6)
        assert found.low < value < found.high and found.high - found.low < 0.02 * value + 0.01
    assert fit.degrees == 5 and fit.rms < 1e-7


def test_the_interval_of_e_alone_is_that_of_student():
    measured = E * forces({}) * (1.0 + 0.03 * np.array([1, -1, 1, -1, 1, 1, -1, -1]))
    fit = problem(measured).fit()
    design = forces({}) / measured
    value = design.sum() / (design @ design)
    error = np.sqrt(((value * design - 1.0) ** 2).sum() / 7 / (design @ design))
    half = student.ppf(0.975, 7) * error
    found = fit.intervals["E"]
    assert [found.value, found.low, found.high] == pytest.approx([value, value - half, value + half], rel=1e-4)


@pytest.mark.parametrize(
    ("free", "draws"),
    [
        pytest.param(("offset",), 80, marks=pytest.mark.slow),
        pytest.param(("offset",), 400, marks=pytest.mark.long),
        pytest.param(("offset", "power"), 400, marks=pytest.mark.long),
    ],
)
def test_intervals_cover_the_truth_at_their_rate(free, draws):
    """The share of covered draws of noise may be three standard deviations off."""
    noise, clean = np.random.default_rng(1), E * forces(TRUE)
    covered = dict.fromkeys(("E", *free), 0)
    for _ in range(draws):
        fit = problem(clean * (1.0 + 0.02 * noise.normal(size=len(DEPTH))), *free).fit()
        for name, interval in fit.intervals.items():
            low, high = (-np.inf if interval.low is None else interval.low), interval.high or np.inf
            covered[name] += low <= {"E": E, **TRUE}[name] <= high
    for count in covered.values():
        assert abs(count / draws - CONFIDENCE) < 3.0 * np.sqrt(CONFIDENCE * (1.0 - CONFIDENCE) / draws)


def test_known_errors_bound_an_interval_from_below():
    """A lucky fit of two points is not better than the measurement; a bad one is as bad as it looks."""
    measured = E * forces({})
    lucky = problem(measured, sigma=0.05 * measured, is_absolute=True).fit().intervals["E"]
    assert lucky.high / E - 1.0 == pytest.approx(student.ppf(0.975, 7) * 0.05 / np.sqrt(8), rel=1e-3)
    off = measured * (1.0 + 0.2 * np.array([1, -1, 1, -1, 1, -1, 1, -1]))
    bad = problem(off, sigma=0.05 * measured, is_absolute=True).fit()
    assert bad.scatter == pytest.approx(4.3, abs=0.1)
    assert bad.intervals["E"].high - bad.intervals["E"].low > 3.5 * (lucky.high - lucky.low)


@pytest.mark.parametrize("std", [0.001, 0.05])
def test_chance_and_interval_agree(std):
    """A fit with an offset of 0 is told apart where the interval of the offset does not hold 0, and only there."""
    noise, told = np.random.default_rng(6).normal(size=len(DEPTH)), set()
    for offset in (0.0, 0.01, 0.02, 0.04, 0.08):
        measured = E * forces({"offset": offset}) * (1.0 + 0.001 * noise)
        alone, fit = (
            problem(measured, *free, sigma=std * measured, is_absolute=True).fit() for free in ((), ("offset",))
        )
        interval = fit.intervals["offset"]
        assert (chance(alone, fit, True) < 1.0 - CONFIDENCE) == (not interval.low < 0.0 < interval.high)
        told.add(interval.low > 0.0)
    assert told == {True, False}


def test_the_scatter_of_other_models_counts_from_the_known_errors_on():
    """Two models that both fit better than the forces are known are not told apart."""
    measured = E * forces({"offset": 0.01})
    alone, power = (
        problem(measured, *free, sigma=0.05 * measured, is_absolute=True).fit() for free in ((), ("power",))
    )
    assert alone.scatter > 3.0 * power.scatter and chance(alone, power, False) > 0.4


def test_a_parameter_that_forces_do_not_feel_is_not_determined():
    measured = E * forces({}) * (1.0 + 0.02 * np.random.default_rng(2).normal(size=8))
    fit = LeastSquares(measured, measured, lambda values: forces({}), {"idle": (0.0, 1.0)}).fit()
    assert not fit.intervals["idle"].is_determined and fit.intervals["E"].is_determined


def test_without_degrees_of_freedom_there_are_no_intervals():
    fit = LeastSquares(np.array([1.0, 3.0]), np.ones(2), lambda values: np.array([1.0, 1.0 + values["a"]]),
                       {"a": (0.0, 5.0)}).fit()  # fmt: skip
    assert fit.values == pytest.approx({"E": 1.0, "a": 2.0}, rel=1e-6)
    assert fit.degrees == 0 and np.isnan(fit.scatter) and not fit.intervals["E"].is_determined
    assert np.isnan(chance(fit, fit, True))


@pytest.mark.parametrize("draws", [pytest.param(80, marks=pytest.mark.slow), pytest.param(400, marks=pytest.mark.long)])
def test_equal_models_are_told_apart_at_the_rate_of_the_test(draws):
    """Without an offset in the data, the F test refuses the model without one in 5 % of the draws."""
    noise, clean = np.random.default_rng(3), E * forces({})
    chances = []
    for _ in range(draws):
        measured = clean * (1.0 + 0.02 * noise.normal(size=len(DEPTH)))
        chances.append(chance(problem(measured).fit(), problem(measured, "offset").fit(), True))
    assert abs(np.mean(np.array(chances) < 0.05) - 0.05) < 3.0 * np.sqrt(0.05 * 0.95 / draws)
    unequal = problem(E * forces(TRUE)).fit(), problem(E * forces(TRUE), "offset").fit()
    assert chance(*unequal, True) < 1e-6 and chance(*unequal, False) < 1e-3
