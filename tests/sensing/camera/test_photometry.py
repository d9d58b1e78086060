"""Lambert's law at points where it can be worked out by hand."""

import numpy as np
import pytest

from simgen.errors import InputError
from simgen.sensing.camera.photometry import Photometry

LIGHTS = np.array([[0.0, 0.0, 2.0], [3.0, 0.0, 4.0], [0.0, -5.0, 0.0]])  # m: red, green and blue
UP = np.array([0.0, 0.0, 1.0])


def of(points, normals, **changes) -> np.ndarray:
    return Photometry(LIGHTS, **({"crosstalk": 0.0, "albedo": 1.0} | changes)).radiance(
        np.array(points), np.array(normals)
    )


def test_a_light_straight_above_a_slanting_one_and_one_in_the_plane():
    """Red: cos 0 / 2^2. Green: 5 away, its cosine 4 / 5. Blue: in the plane of the coat."""
    assert of([0.0, 0.0, 0.0], UP) == pytest.approx([0.25, 0.8 / 25.0, 0.0])


def test_a_coat_that_turns_follows_the_cosine():
    angles = np.radians([0.0, 30.0, 60.0, 89.0])
    normals = np.stack([np.sin(angles), np.zeros(4), np.cos(angles)], axis=1)
    red = of(np.zeros((4, 3)), normals)[:, 0]
    assert red == pytest.approx([0.25, 0.25 * np.sqrt(0.75), 0.125, 0.25 * np.sin(np.radians(1.0))])


def test_twice_as_far_is_a_quarter():
    near, far = of([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]], [UP, UP])[:, 0]
    assert near == pytest.approx(4.0 * far)


def test_what_looks_away_from_a_light_has_nothing_of_it():
    assert of([0.0, 0.0, 0.0], -UP)[:2] == pytest.approx([0.0, 0.0])


def test_channels_see_some_of_the_other_lights_and_the_coat_keeps_some():
    red, green = 0.25, 0.8 / 25.0
    mixed = 0.6 * np.array([red + 0.1 * green, green + 0.1 * red, 0.1 * (red + green)])
    assert of([0.0, 0.0, 0.0], UP, crosstalk=0.1, albedo=0.6) == pytest.approx(mixed)


def test_the_brightest_untouched_place_is_as_bright_as_the_exposure_says():
    model = Photometry(LIGHTS, ambient=0.2, brightest=150.0)
    untouched = np.array([[0.1, 0.5, 2.0], [np.nan, 1.0, 0.0]])
    image = model.image(untouched, model.exposure(untouched))
    assert np.nanmax(image) == pytest.approx(150.0)
    assert image[1, 2] == pytest.approx(0.2 * 150.0)  # ambient alone
    assert image[0, 1] == pytest.approx(30.0 + 0.25 * 120.0)


def test_gel_in_the_dark_is_one_line():
    with pytest.raises(InputError, match="camera: no light shines on the gel; allowed: lights on the camera's side"):
        Photometry(LIGHTS).exposure(np.zeros((2, 2, 3)))


def test_a_camera_sees_no_more_than_white():
    model = Photometry(LIGHTS)
    assert model.image(np.full(3, 1e3), 1.0).max() == 255.0
