"""`simgen render`: smoothing of height maps, and bad input."""

import json
from pathlib import Path

import numpy as np
import pytest
from refusal import check_refusal, contents, simgen

from simgen.sensing.camera.image_files import read_image
from tests.sensing.camera.scenes import dots_on_ball

SMALL = "--size 48x64 --workers 1 --trajectories 0"


@pytest.fixture
def rendered(fake_dataset, tmp_path, monkeypatch, capfd):
    """Render with some options; return the record and the deepest image."""
    monkeypatch.chdir(tmp_path)

    def made(folder: str, options: str):
        code, _, errors = simgen(f"render {fake_dataset.path} {SMALL} -o {folder} {options}", monkeypatch, capfd)
        assert (code, errors) == (0, "")
        deepest = sorted(tmp_path.glob(f"{folder}/t0000_*/03_*.png"))[0]
        return json.loads((tmp_path / folder / "render.json").read_text()), read_image(deepest).astype(int)

    return made


def test_blur_is_whole_across_or_none(rendered):
    (whole, image), (across, wider), (none, sharp) = (
        rendered(*each) for each in (("a", ""), ("b", "--blur across"), ("c", "--no-blur"))
    )
    assert (whole["kernels"], whole["kernels_around_contact"]) == ([5, 3], [])
    assert (across["kernels"], across["kernels_around_contact"]) == ([5, 3], [41, 21, 11])
    assert (none["kernels"], none["kernels_around_contact"]) == ([], [])
    assert all(np.abs(image - other).max() > 2 for other in (wider, sharp))


def test_whole_is_the_default(rendered):
    (record, image), (default, same) = rendered("a", "--blur whole"), rendered("b", "")
    assert record == default
    np.testing.assert_array_equal(image, same)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--blur soft", "--blur 'soft': allowed: whole, across"),
        ("--vary 7 --calibration x.npz", "--calibration x.npz: contradicts --vary, which needs no table; allowed: one"),
        ("--vary -1", "--vary -1: allowed: 0 or more"),
        ("--blur across --no-blur", "--no-blur: contradicts --blur across; allowed: one of them"),
        ("--markers own", "digit/sensor.yaml has no markers; allowed: ROWSxCOLUMNS@PITCH, or a CSV file"),
        ("--markers 3x2@1.5", "--markers 3x2@1.5: --dot-mm is missing, and "),
        ("--dot-mm 1", "--dot-mm 1: no --markers; allowed: with --markers"),
        ("--markers dots --dot-mm 1", "--markers dots: allowed: own, ROWSxCOLUMNS@PITCH in mm such as 7x9@2.05"),
        ("--markers dots.csv --dot-mm 1", "dots.csv: cannot be read: No such file or directory"),
        ("--markers 1x99@2 --dot-mm 1", "--markers 1x99@2: row 1, column 1: off the coat"),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(fake_dataset, tmp_path, monkeypatch, capfd, options, words):
    monkeypatch.chdir(tmp_path)
    check_refusal(*simgen(f"render {fake_dataset.path} {SMALL} -o out {options}", monkeypatch, capfd), words)
    assert not contents(tmp_path)


def test_another_sensor_for_each_press(rendered):
    (record, image), (plain, own) = rendered("a", "--vary 7 --gif"), rendered("b", "")
    assert record["vary"] == 7 and "vary" not in plain and np.abs(image - own).max() > 10


def dots(folder: Path, count: int = 6, size_mm: float = 0.8) -> str:
    """Options for dots on the ball."""
    return f"--markers {dots_on_ball(folder / f'{count}.csv', count)} --dot-mm {size_mm}"


def test_dots_are_drawn_and_their_displacements_stored(rendered, tmp_path):
    (plain, image), (record, dotted) = rendered("a", ""), rendered("b", f"{dots(tmp_path)} --gif")
    assert plain["markers"] == {"number": 0}
    assert (record["markers"]["number"], record["markers"]["diameter_mm"]) == (6, 0.8)
    assert (dotted <= image).all() and (dotted[image > 20] == 0).any()
    assert {"rest.png", "markers.csv"} <= {file.name for file in (tmp_path / "b").iterdir()}
    assert not {"rest.png", "markers.csv"} & {file.name for file in (tmp_path / "a").iterdir()}
    for press in tmp_path.glob("b/t*"):
        assert np.load(press / "markers.npz")["displacement_px"].shape == (4, 6, 2)


def test_other_dots_are_refused_with_the_difference(fake_dataset, rendered, tmp_path, monkeypatch, capfd):
    given, fewer, smaller = dots(tmp_path), dots(tmp_path, count=5), dots(tmp_path, size_mm=0.7)
    rendered("a", given)
    before = contents(tmp_path)
    for options, words in (
        (fewer, "holds other images: markers.number: 6 -> 5; choose another --output"),
        (smaller, "holds other images: markers.diameter_mm: 0.8 -> 0.7"),
        ("", "holds other images: markers.number: 6 -> 0"),
    ):
        check_refusal(*simgen(f"render {fake_dataset.path} {SMALL} -o a {options}", monkeypatch, capfd), words)
    assert contents(tmp_path) == before


def test_dots_are_drawn_on_drawn_sensors(rendered, tmp_path):
    (_, image), (record, dotted) = rendered("a", "--vary 7"), rendered("b", f"--vary 7 --gif {dots(tmp_path)}")
    assert record["vary"] == 7 and record["markers"]["number"] == 6
    assert (dotted <= image).all() and (dotted[image > 20] == 0).any()
    assert (tmp_path / "b" / "markers.csv").exists() and not (tmp_path / "b" / "rest.png").exists()
    assert all((press / "markers.npz").exists() and (press / "optics.json").exists() for press in tmp_path.glob("b/t*"))
