"""Tables fitted on surfaces of presses: places, depths and colours of made-up pictures are found again."""

import numpy as np
import pytest

from simgen.config.resources import resource
from simgen.sensing.camera.ball_presses import BallPresses
from simgen.sensing.camera.imprint import find_imprint
from simgen.sensing.camera.press_fit import PicturedPress, PressedPictures
from simgen.sensing.camera.response import Response
from simgen.sensing.camera.spheres import Circle
from simgen.sensors.pinhole import Pinhole
from tests.sensing.camera.scenes import camera

HEIGHT, WIDTH, AWAY_M, RADIUS_M = 160, 120, 0.02, 3e-3
DEPTHS_M = np.array([0.3e-3, 0.6e-3, 0.9e-3])
TRUE = [(35, 40, 0.5), (80, 45, 0.7), (60, 80, 0.4), (40, 115, 0.8), (85, 120, 0.6), (60, 60, 0.65)]


def dents(place: Circle, pinhole: Pinhole) -> np.ndarray:
    """Dents (depth, height, width), steps of 0.1 um: a ball's cap with a soft rim, on a flat gel."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    beside = np.hypot(columns - place.column, rows - place.row) * AWAY_M / pinhole.focal
    caps = DEPTHS_M[:, None, None] - RADIUS_M + np.sqrt(np.maximum(RADIUS_M**2 - beside**2, 0.0))
    soft = 5e-5
    return np.rint(1e7 * soft * np.logaddexp(0.0, caps / soft)).astype(np.int16)


@pytest.fixture(scope="module")
def pressed():
    """Pictures in the colours of the DIGIT's own table, with presses simulated up to four pixels aside."""
    pinhole, random = Pinhole.of(camera(HEIGHT, WIDTH)), np.random.default_rng(1)
    table = Response.load(resource("sensor_models") / "digit" / "optics.npz")
    true = [PicturedPress(1e-3 * depth, *random.uniform(-4.0, 4.0, 2)) for _, _, depth in TRUE]
    places = [Circle(column, row, 1.0) for column, row, _ in TRUE]
    heights = np.stack([dents(place, pinhole) for place in places])
    presses = BallPresses(heights, 1e-7, DEPTHS_M, np.full((HEIGHT, WIDTH), AWAY_M), pinhole)
    background = np.full((HEIGHT, WIDTH, 3), 128, np.uint8)
    made = PressedPictures(np.zeros((len(TRUE), HEIGHT, WIDTH, 3), np.uint8), background, places, presses)
    pictures = np.stack([made.picture(table, number, press) for number, press in enumerate(true)])
    circles = [find_imprint(picture.astype(float) - background) for picture in pictures]
    return PressedPictures(pictures, background, circles, presses), table, true


def test_colours_find_the_place_and_the_depth(pressed):
    pictures, table, true = pressed
    for number, press in enumerate(true):
        found = pictures.press_by_colours(table, number, pictures.press_by_slope(number))
        assert found.depth_m == pytest.approx(press.depth_m, abs=2e-5)
        assert abs(found.right - press.right) < 0.3 and abs(found.down - press.down) < 0.3


def test_the_radius_finds_the_depth(pressed):
    """To half of the distance of the simulated depths: between them, the radius is no linear function."""
    pictures, table, true = pressed
    for number, press in enumerate(true):
        assert pictures.press_by_radius(table, number).depth_m == pytest.approx(press.depth_m, abs=1.5e-4)


def test_a_fitted_table_shows_a_picture_that_it_was_not_fitted_to(pressed):
    pictures, _, true = pressed
    response, presses = pictures.fit(range(5), source="made up")
    assert response.source == "made up" and len(presses) == 5
    for found, press in zip(presses, true, strict=False):
        assert found.depth_m == pytest.approx(press.depth_m, abs=1.5e-4)
    other = pictures.picture(response, 5, true[5]).astype(float)
    near = pictures.around(5, 1.0)
    off, change = (np.abs(pictures.pictures[5] - each)[near].mean() for each in (other, 128.0))
    assert off < 0.25 * change
