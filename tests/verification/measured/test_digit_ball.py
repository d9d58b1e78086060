"""The case of a ball in a real DIGIT: its measures, and a short run with four of the pictures."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from simgen.verification.measured import digit_ball
from simgen.verification.measured.digit_ball import FOLDER, gradient_correlation, imprints, similarity
from simgen.verification.validate.case import Context


def picture(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 255, (60, 50, 3), dtype=np.uint8)


def test_equal_images_are_similar_and_unrelated_ones_are_not():
    one, other = picture(), picture(1)
    np.testing.assert_allclose(similarity(one, one), 1.0)
    assert similarity(one, other).mean() < 0.2
    darker = np.uint8(0.8 * one)
    assert 0.8 < similarity(one, darker).mean() < 1.0


def test_gradients_correlate_by_direction():
    rows, columns = np.mgrid[:60, :50]
    one = np.stack([np.sin(0.3 * columns) + np.cos(0.2 * rows)] * 3, axis=-1)
    other = np.stack([np.sin(0.3 * columns) - np.cos(0.2 * rows)] * 3, axis=-1)
    along_rows, along_columns = gradient_correlation(one, other, np.ones((60, 50), bool))
    assert along_rows == pytest.approx(1.0) and along_columns == pytest.approx(-1.0)


def test_pictures_without_a_usable_imprint_are_left_out():
    background = np.full((160, 120, 3), 100, np.uint8)
    dot, all_of_it = background.copy(), background.copy()
    dot[60:90, 40:70] = 180
    all_of_it[10:150, 10:110] = 180
    found = imprints(np.stack([background, dot, all_of_it]), background, most_px=30.0)
    assert list(found) == [1] and found[1].radius == pytest.approx(30.0 / np.sqrt(np.pi), abs=2.5)


def test_it_is_skipped_without_pictures(tmp_path):
    for measured in (None, tmp_path):
        outcome = digit_ball.digit_ball(Context("cpu", None, None, tmp_path, measured))
        assert outcome.rows == [] and FOLDER in outcome.skipped


def test_four_pictures_make_rows_a_table_and_a_page(reference: Path, tmp_path, monkeypatch):
    """Two fitted pictures are few: their table need not reach the target, but it must beat the untouched gel."""
    source, folder = reference / "measured" / FOLDER, tmp_path / FOLDER
    if not source.is_dir():
        pytest.skip(f"no {source}: the pictures belong to others")
    folder.mkdir()
    for file in ("background_median.png", "frame_13.jpg", "frame_18.jpg", "frame_25.jpg", "frame_26.jpg"):
        shutil.copy(source / file, folder / file)
    monkeypatch.setattr(digit_ball, "DEPTHS_M", np.array([0.35e-3, 0.7e-3]))
    outcome = digit_ball.digit_ball(Context("cpu", reference, None, tmp_path, tmp_path))
    assert [line[0] for line in outcome.tables[0].rows] == ["the fitted table", "the untouched gel",
                                                            "Taxim's published table"]  # fmt: skip
    fitted, untouched, _ = (line[1] for line in outcome.tables[0].rows)
    assert fitted < untouched
    assert outcome.pictures[0].data.startswith(b"\x89PNG") and "2 pictures fitted, 2 compared" in outcome.notes[0]
