"""Measures of an edge's imprint, on images whose ridge, colours and sizes are known."""

import cv2
import numpy as np
import pytest

from simgen.verification.measured.edge_images import EdgeLine, NormalColours, read_changes, shifted

HEIGHT, WIDTH = 160, 120
PIXEL_M = np.full((HEIGHT, WIDTH), 1e-4)


def along_and_across(ridge: EdgeLine) -> tuple[np.ndarray, np.ndarray]:
    """Distances (height, width), px, from the middle of a ridge."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    right, down, (x, y) = columns - ridge.column, rows - ridge.row, ridge.direction
    return right * x + down * y, down * x - right * y


def bar(ridge: EdgeLine, width_px: float, length_px: float) -> np.ndarray:
    along, across = along_and_across(ridge)
    inside = (np.abs(along) < 0.5 * length_px) & (np.abs(across) < 0.5 * width_px)
    return 30.0 * np.repeat(inside[..., None], 3, axis=2).astype(np.float32)


def test_a_ridge_has_the_place_and_direction_of_a_bar():
    angle = np.radians(-50.0)
    true = EdgeLine(64.0, 75.0, (np.cos(angle), np.sin(angle)))
    found = EdgeLine.of(bar(true, 9.0, 70.0))
    assert (found.column, found.row) == pytest.approx((64.0, 75.0), abs=0.3)
    assert np.degrees(np.arctan2(found.direction[1], found.direction[0])) == pytest.approx(-50.0, abs=0.5)


@pytest.mark.parametrize(("width_px", "length_px"), [(12.0, 60.0), (25.0, 80.0)])
def test_an_extent_is_that_of_a_bar(width_px, length_px):
    ridge = EdgeLine(60.0, 80.0, (0.6, -0.8))
    width, length = ridge.extent(bar(ridge, width_px, length_px), pixel_mm=0.1)
    assert width == pytest.approx(0.1 * width_px, abs=0.06)
    assert length == pytest.approx(0.1 * length_px, abs=0.06)


def roof_heights(ridge: EdgeLine, half_width_px: float, slope: float) -> np.ndarray:
    """Height map, m, of an infinite roof that rises by ``slope`` up to its ridge."""
    _, across = along_and_across(ridge)
    return 1e-4 * slope * np.maximum(half_width_px - np.abs(across), 0.0)


def test_colours_of_its_own_form_are_found_and_given_back():
    ridge = EdgeLine(60.0, 80.0, (0.6, -0.8))
    heights = np.array([roof_heights(ridge, half, 0.4) for half in (6.0, 12.0, 18.0)])
    heights += 1e-5 * np.random.default_rng(3).standard_normal(heights.shape)  # so that no two terms are alike
    true = NormalColours(np.random.default_rng(4).normal(size=(15, 3)), blur_px=2.0)
    changes = np.array([true(height, PIXEL_M) for height in heights])
    found = NormalColours.fit(heights, PIXEL_M, changes, np.ones((HEIGHT, WIDTH), bool), blur_px=2.0)
    np.testing.assert_allclose(found.coefficients, true.coefficients, atol=1e-3)


def test_flat_gel_has_no_colours_and_steep_gel_bounded_ones():
    colours = NormalColours(np.ones((15, 3)), blur_px=0.0)
    assert not colours(np.zeros((HEIGHT, WIDTH)), PIXEL_M).any()
    cliff = np.zeros((HEIGHT, WIDTH))
    cliff[:, 60:] = 1.0
    assert np.abs(colours(cliff, PIXEL_M)).max() < 15.0


def test_a_shift_moves_an_image():
    image = np.random.default_rng(0).random((20, 30)).astype(np.float32)
    np.testing.assert_allclose(shifted(image, 3.0, -2.0)[:-2, 3:], image[2:, :-3], atol=1e-6)


def test_frames_are_turned_with_the_fingertip_up_and_their_light_is_removed(tmp_path):
    dot = np.zeros((48, 64), bool)
    dot[10:14, 50:54] = True  # near the right end of a landscape frame, above its middle
    for frame in range(6):
        image = np.full((48, 64, 3), 100 + (5 if frame == 5 else 0), np.uint8)
        image[dot] += np.uint8(40 * (frame == 5))
        cv2.imwrite(str(tmp_path / f"edge6_{frame:02d}.png"), image)
    changes = read_changes(tmp_path, "edge6_*.png", 64, 48)
    assert changes.shape == (6, 64, 48, 3) and not changes[:5].any()
    rows, columns = np.nonzero(changes[5, :, :, 0])
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (10, 13, 10, 13)  # up, and at the left
    assert changes[5].max() == 40.0
