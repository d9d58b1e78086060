"""`simgen calibrate-optics --simulate`: a table from pictures of a real sensor, and options that do not fit."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from refusal import check_refusal, simgen

from simgen.errors import InputError
from simgen.sensing.camera import calibrate_by_presses
from simgen.sensing.camera.calibrate_by_presses import fit_to_simulated_presses
from simgen.sensing.camera.response import Response


@pytest.fixture
def few_depths(monkeypatch):
    monkeypatch.setattr(calibrate_by_presses, "simulated_depths", lambda radius: np.array([0.35e-3, 0.7e-3]))


def test_pictures_of_a_real_sensor_make_a_table(reference: Path, tmp_path, few_depths):
    folder, output = reference / "measured" / "digit_ball_r3mm", tmp_path / "table.npz"
    if not folder.is_dir():
        pytest.skip(f"no {folder}: the pictures belong to others")
    pictures = [folder / f"frame_{number}.jpg" for number in (13, 25)] + [folder / "background_median.png"]
    lines = list(fit_to_simulated_presses(pictures, folder / "background_median.png", 3e-3, "digit", output))
    assert lines[0].startswith(f"left out: {pictures[-1]}: no contact")
    assert lines[1] == "pressing a ball of 3 mm at 2 places"
    change, off = map(float, re.search(r"change by ([\d.]+) grey levels .* are ([\d.]+) off$", lines[-1]).groups())
    assert "of 2 of 3 pictures" in lines[-1] and change > 10.0 and off < 0.4 * change
    assert Response.load(output).source == "pictures of a sphere"


def test_pictures_without_a_contact_write_nothing(tmp_path):
    for name in ("nothing.png", "a.png", "b.png"):
        cv2.imwrite(str(tmp_path / name), np.full((320, 240, 3), 90, np.uint8))
    lines = fit_to_simulated_presses([tmp_path / "a.png", tmp_path / "b.png"], tmp_path / "nothing.png", 3e-3, "digit",
                                     tmp_path / "t.npz")  # fmt: skip
    assert next(lines).startswith("left out: ") and next(lines).startswith("left out: ")
    with pytest.raises(InputError, match="2 of 2 pictures left out; allowed: at most half"):
        next(lines)
    assert not (tmp_path / "t.npz").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--simulate", "--simulate: no PICTURE; allowed: pictures, whose imprints it finds itself"),
        ("a.png --simulate --circles c.csv", "--simulate: --circles c.csv; allowed: pictures"),
        ("a.png --simulate --background a.png -o t.npz", "--radius-mm is missing; allowed with pictures: "),
        ("a.png --simulate --background a.png --radius-mm 0 -o t.npz", "--radius-mm 0: allowed: more than 0"),
        ("a.png --simulate --background a.png --radius-mm 3 -o t.npz", "picture of 300 x 320 pixels: allowed: sides"),
    ],
)
def test_bad_options_are_one_line(options, words, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    cv2.imwrite("a.png", np.full((320, 300, 3), 90, np.uint8))
    check_refusal(*simgen(f"calibrate-optics {options}", monkeypatch, capfd), words)
