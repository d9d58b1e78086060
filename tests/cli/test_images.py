"""`simgen render`: smoothing of height maps, and bad input."""

import json

import numpy as np
import pytest
from refusal import check_refusal, contents, simgen

from simgen.sensing.camera.image_files import read_image

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
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(fake_dataset, tmp_path, monkeypatch, capfd, options, words):
    monkeypatch.chdir(tmp_path)
    check_refusal(*simgen(f"render {fake_dataset.path} {SMALL} -o out {options}", monkeypatch, capfd), words)
    assert not contents(tmp_path)


def test_another_sensor_for_each_press(rendered):
    (record, image), (plain, own) = rendered("a", "--vary 7 --gif"), rendered("b", "")
    assert record["vary"] == 7 and "vary" not in plain and np.abs(image - own).max() > 10
