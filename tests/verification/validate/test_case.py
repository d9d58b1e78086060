"""Rows pass or fail by their kind, and cases need a known level and a new name."""

import math

import pytest

from simgen.verification.validate.case import CASES, Outcome, case
from tests.verification.validate.fakes import good_row


@pytest.mark.parametrize(
    "kind, reference, tolerance, inside, outside",
    [
        ("relative", 4.0, 0.01, 4.0399, 4.0401),
        ("relative", -4.0, 0.01, -3.9601, -3.9599),
        ("absolute", 4.0, 0.01, 3.9901, 3.9899),
        ("at least", math.nan, 2.8, 2.8, 2.7999),
        ("at most", math.nan, 1e-10, 1e-10, 1.01e-10),
    ],
)
def test_a_row_passes_up_to_its_tolerance(kind, reference, tolerance, inside, outside):
    make = {"kind": kind, "reference": reference, "tolerance": tolerance}
    assert good_row(ours=inside, **make).verdict == "ok"
    assert good_row(ours=outside, **make).verdict == "FAIL"
    assert not good_row(ours=math.nan, **make).passed


@pytest.mark.parametrize("kind", ["relative", "absolute"])
def test_a_comparison_without_its_reference_fails(kind):
    assert not good_row(reference=math.nan, kind=kind).passed


def test_the_difference_is_in_the_measure_of_the_kind():
    assert good_row(ours=3.0, reference=-4.0).difference == pytest.approx(7.0 / 4.0)
    assert math.isnan(good_row(reference=0.0).difference)
    assert good_row(ours=3.0, reference=4.0, kind="absolute").difference == -1.0
    assert good_row(ours=3.0, tolerance=2.8, kind="at least").difference == pytest.approx(0.2)


def test_a_kind_a_level_and_a_name_that_cannot_be_are_refused():
    with pytest.raises(ValueError, match=r"kind 'about', allowed: relative, absolute"):
        good_row(kind="about")
    with pytest.raises(ValueError, match=r"level 'slow', allowed: quick, standard, long"):
        case("some-case", "", "slow")
    try:
        case("some-case", "", "quick")(lambda context: Outcome([]))
        with pytest.raises(ValueError, match=r"two cases are called some-case"):
            case("some-case", "", "quick")(lambda context: Outcome([]))
    finally:
        CASES.pop("some-case", None)
