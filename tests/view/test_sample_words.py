"""Words about samples of the stand-ins."""

import fake
import pytest

from simgen.config.outputs import BY_NAME
from simgen.view.drawn_surface import AT_REST
from simgen.view.press_values import PressValues
from simgen.view.sample_words import AT_FIRST_TOUCH, sample_words
from view.conftest import made


def line_of(lines, title):
    (found,) = (line for line in lines if line.title == title)
    return found


def test_a_converged_sample(whole):
    digit, biotac = sample_words(PressValues(whole), 0, 1)
    assert (digit.sensor, biotac.sensor) == whole.sensors
    assert (digit.status, digit.kind, digit.is_valid) == ("Converged.", "converged", True)
    assert line_of(digit.values, "normal force").value == "0.2 N"
    assert line_of(digit.values, "first touch").value == "0 um"
    residual = line_of(digit.certificate, "residual")
    assert (residual.value, residual.allowed, residual.is_within) == ("1e-06", "at most 0.0005", True)
    assert residual.about == BY_NAME["certificate/residual"].about
    penetration = line_of(digit.certificate, "rms penetration")
    assert penetration.value == "1 um" and not penetration.about.endswith(", m") and penetration.is_within is None
    assert line_of(digit.certificate, "newton iterations").value == "4"
    assert digit.verdict == "The certificate is within all its limits."


def test_limits_are_those_of_the_job(tmp_path):
    strict = made(tmp_path / "d.zarr", solver={"residual_tolerance": 1e-7}, trajectories={"count": 1})
    words = sample_words(PressValues(strict), 0, 0)[0]
    assert line_of(words.certificate, "residual").is_within is False
    assert words.verdict == "Beyond its limit: residual is 1e-06, allowed: at most 1e-07."


def test_a_sample_that_failed_has_its_sentence_alone(failing):
    for words in sample_words(PressValues(failing), 1, 3):
        assert (words.status, words.kind, words.is_valid) == ("Stalled.", "failed", False)
        assert words.values == words.certificate == () and words.verdict == ""


def test_inside_out_and_not_pressed(tmp_path):
    values = PressValues(made(tmp_path / "d.zarr", fake.ending_presser, trajectories={"count": 1}))
    ended, inside_out = sample_words(values, 0, 3)[0], sample_words(values, 2, 1)[0]
    assert (ended.status, ended.kind, ended.values) == ("Too strong.", "not pressed", ())
    assert (inside_out.kind, inside_out.is_valid) == ("inside out", False)
    assert inside_out.verdict == "Beyond its limit: inverted elements is 4, allowed: at most 0."


def test_first_touch_and_presses_that_are_not_there_yet(unfinished):
    values = PressValues(unfinished)
    at_rest, later = sample_words(values, 0, AT_REST)[0], sample_words(values, 11, 0)[0]
    assert at_rest.status == AT_FIRST_TOUCH and [line.title for line in at_rest.values] == ["first touch"]
    assert (later.status, later.kind) == ("Not there yet.", "not there yet")
    assert sample_words(values, 11, AT_REST)[0].status == "Not there yet."


def test_estimated_errors_have_units(estimating):
    lines = sample_words(PressValues(estimating), 0, 2)[0].values
    assert line_of(lines, "surface error estimate").value == "3 um"
    assert line_of(lines, "force error estimate").value == "3 %"
    known = [line.title for line in sample_words(PressValues(estimating), 0, 3)[0].values]
    assert "surface error estimate" not in known  # none at the last depth


def test_a_path_and_a_fluid_say_more(sliding, tmp_path):
    lines = sample_words(PressValues(sliding), 0, 5)[0].values
    assert line_of(lines, "slip share").value == "50 %" and line_of(lines, "shear force").value.startswith("(0.004, ")
    filled = made(tmp_path / "d.zarr", sensors=fake.FILLED, trajectories={"count": 1})
    biotac = sample_words(PressValues(filled), 0, 0)[1]
    assert line_of(biotac.values, "cavity pressure").value == "0.1 kPa"
    assert line_of(biotac.certificate, "liquid volume error").is_within


def test_where_nothing_touched_no_travel_is_stated(tmp_path):
    missed = made(tmp_path / "d.zarr", fake.missing_presser, trajectories={"count": 1})
    digit = sample_words(PressValues(missed), 1, AT_REST)[0]
    assert (digit.status, digit.kind, digit.values) == ("Never touched.", "failed", ())


def test_imported_files_state_no_certificate(imported):
    words = sample_words(PressValues(imported), 0, 0)[0]
    assert words.status == "In a file that was imported." and words.certificate == ()
    absent = sample_words(PressValues(imported), 1, 3)[0]
    assert (absent.kind, absent.values) == ("not there yet", ())


@pytest.mark.parametrize("step", [0, AT_REST])
def test_every_line_says_what_it_is(whole, step):
    for words in sample_words(PressValues(whole), 0, step):
        assert all(line.title and line.value and line.about for line in (*words.values, *words.certificate))
