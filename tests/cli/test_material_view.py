"""Words of the view: intervals that are open, and warnings about values that the data leave open."""

import numpy as np
import pytest

from simgen.calibration.fit import CurveFit, Interval
from simgen.calibration.material_fit import FittedModel, MaterialModel
from simgen.cli.material_view import in_words, print_level, print_models, print_warnings

FIXED = {"nu": 0.475, "friction": 0.0, "c20": 0.0, "c30": 0.0}


def fitted(*free, degrees=2, ends=(None, None), chance=float("nan")):
    intervals = {"E": Interval(4e5, 3e5, 5e5), **{name: Interval(0.1, *ends) for name in free}}
    return FittedModel(MaterialModel(FIXED, free), CurveFit(intervals, np.array([0.01, -0.01]), 2e-4, degrees), chance)


@pytest.mark.parametrize(
    ("low", "high", "words"),
    [
        (0.05, 0.2, "0.1 (0.05 to 0.2)"),
        (None, 0.2, "0.1 (at most 0.2)"),
        (0.05, None, "0.1 (at least 0.05)"),
        (None, None, "0.1 (not determined)"),
    ],
)
def test_an_interval_in_words(low, high, words):
    assert in_words("nu", Interval(0.1, low, high), 2) == words
    assert in_words("nu", Interval(0.1, low, high), 0) == "0.1 (no interval)"


def test_e_is_in_kpa():
    assert in_words("E", Interval(4.2e5, 4e5, 4.5e5), 1) == "420 (400 to 450)"


def test_models_and_warnings(capsys):
    print_models([fitted("friction"), fitted(chance=0.01), fitted("nu", ends=(0.05, None), chance=0.3)])
    out = capsys.readouterr().out
    assert "E, friction; nu 0.475" in out and "friction 0.1 (not determined)" in out
    assert out.count("told apart") == 1 and "nu 0.1 (at least 0.05)" in out
    assert "its chance is below 0.05." in out
    print_level([FittedModel(MaterialModel(FIXED), fitted().fit, level=0.05 / 7)])
    assert "below 0.0071 (0.05 over 7 competing models)" in capsys.readouterr().out
    print_warnings(fitted("friction"))
    assert "friction is not determined by these data" in capsys.readouterr().out
    print_warnings(fitted("friction", degrees=0))
    assert "As many parameters as points" in capsys.readouterr().out
