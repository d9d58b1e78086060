"""Imprints in pictures: their middle and radius, also with an unlit side, and pictures without one."""

import numpy as np
import pytest

from simgen.errors import InputError
from simgen.sensing.camera.imprint import find_imprint


def ring(column: float, row: float, radius: float, height: int = 320, width: int = 240) -> np.ndarray:
    """Changes of colour (height, width, 3) that grow from the middle to the rim, brighter to the right."""
    rows, columns = np.mgrid[:height, :width]
    away = np.hypot(columns - column, rows - row)
    light = 0.75 + 0.25 * (columns - column) / np.maximum(away, 1.0)
    return (100.0 * np.where(away < radius, away / radius, 0.0) * light)[..., None] * [1.0, -0.5, 0.2]


@pytest.mark.parametrize(("column", "row", "radius"), [(120.0, 160.0, 30.0), (60.3, 220.7, 45.0)])
def test_middle_and_radius_are_found_to_two_pixels(column, row, radius):
    found = find_imprint(ring(column, row, radius))
    assert abs(found.column - column) < 2.0 and abs(found.row - row) < 2.0
    assert found.radius == pytest.approx(radius, abs=2.0)


def test_images_of_twice_the_size_have_imprints_of_twice_the_size():
    one, two = find_imprint(ring(100.0, 150.0, 35.0)), find_imprint(ring(200.0, 300.0, 70.0, 640, 480))
    assert two.radius / one.radius == pytest.approx(2.0, rel=0.02)


def test_the_largest_region_counts():
    found = find_imprint(ring(70.0, 100.0, 35.0) + 2.0 * ring(180.0, 260.0, 10.0))
    assert abs(found.column - 70.0) < 3.0 and found.radius > 30.0


def test_noise_is_no_contact():
    noise = np.random.default_rng(0).normal(0.0, 4.0, (320, 240, 3))
    with pytest.raises(InputError, match=r"no contact: colours change by at most [\d.]+ levels; allowed: 16 and more"):
        find_imprint(noise)
