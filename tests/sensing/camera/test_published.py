"""Presses of a sphere rendered by the published table of a real DIGIT, and by simgen's own table and its model."""

import numpy as np
import pytest

from simgen.config.resources import resource
from simgen.sensing.camera.blur import scaled_kernels
from simgen.sensing.camera.image_files import read_image
from simgen.sensing.camera.renderer import BACKGROUND, TABLE, Renderer
from simgen.sensing.camera.response import Response
from simgen.sensors.height_map import HeightMaps
from simgen.sensors.pinhole import Pinhole
from simgen.sensors.sensor import place_camera
from simgen.sensors.sensor_geometry import load_geometry


@pytest.fixture(scope="module")
def surface():
    """The true surface of the gel: vertices, m, and triangles."""
    mesh = load_geometry("digit").true.surface
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


@pytest.fixture(scope="module")
def renderer(reference, surface) -> Renderer:
    folder = reference / "digit"
    camera = place_camera(load_geometry("digit").description.cameras["default"])
    table, background = Response.load(folder / "polycalib.npz"), read_image(folder / "background_240x320.jpg")
    return Renderer(HeightMaps.of_mesh(*surface, Pinhole.of(camera)), table, background, kernels=())


@pytest.fixture(scope="module")
def own(surface, digit) -> Renderer:
    folder = resource("sensor_models") / "digit"
    table, background = Response.load(folder / TABLE), read_image(folder / BACKGROUND)
    return Renderer(HeightMaps.of_mesh(*surface, digit.pinhole), table, background, kernels=scaled_kernels(240))


def pressed(vertices: np.ndarray, deep: float, radius: float = 3e-3) -> np.ndarray:
    """Displacements (1, vertex, 3) m by a sphere that moves straight in, in the middle of the pad: y = -8.30 mm."""
    middle = np.array([-7.56e-3, -8.30e-3 + deep - radius, 0.0])
    beside = np.hypot(*(vertices - middle)[:, [0, 2]].T)
    top = middle[1] + np.sqrt(np.maximum(radius**2 - beside**2, 0.0))
    pad = (beside < radius) & (vertices[:, 1] < -5e-3)  # not the back
    return np.where(pad, np.maximum(top - vertices[:, 1], 0.0), 0.0)[None, :, None] * [0.0, 1.0, 0.0]


def test_the_table_is_taxim_s(renderer):
    response = renderer.shading.response
    assert (response.bins, response.width, response.height, response.source) == (125, 640, 480, "")


def test_untouched_gel_is_the_published_background(reference, renderer, surface):
    background = read_image(reference / "digit" / "background_240x320.jpg")
    np.testing.assert_array_equal(renderer(np.zeros((1, *surface[0].shape)))[0], background)


def test_a_sphere_changes_what_it_touches(renderer, surface):
    """Pixels change inside the circle where it meets the gel. Facets around are of half a millimetre."""
    image = renderer(pressed(surface[0], 1e-3))[0].astype(int)
    change = np.abs(image - renderer.background).max(axis=2)
    rows, columns = np.mgrid[:320, :240]
    pixel = (10.7635e-3 + 8.30e-3) / renderer.pinhole.focal
    away = pixel * np.hypot(rows - 159.5, columns - 119.5)
    circle = np.sqrt(3e-3**2 - 2e-3**2)  # of a flat gel; a dome's is smaller
    assert change[away > circle + 5e-4].max() == 0
    assert change[away < 0.7 * circle].mean() > 5.0
    deeper = np.abs(renderer(pressed(surface[0], 1.5e-3))[0].astype(int) - renderer.background).sum()
    assert deeper > np.abs(image - renderer.background).sum()


def test_our_own_images_are_those_of_the_photometric_model(own, surface, digit):
    """The same heights, at half the size of the images that the table was made for. The dome causes a tenth of the
    change, see `test_photometric_gel`. Rounding to grey levels twice is half a level on average.
    """
    height = own.blur(own.heights(pressed(surface[0], 1e-3)))
    image = own.image(height).numpy()[0].astype(float)
    expected = digit.picture(digit.rest_depth - height.numpy()[0])
    touched = height.numpy()[0] > 1e-5
    change = np.abs(expected - digit.background)[touched].mean()
    assert change > 10.0
    assert np.abs(image - expected)[touched].mean() < 0.1 * change + 0.5
    away = ~touched & (np.arange(320)[:, None] > 70)  # the gel's walls, in the upper corners, blur in the smaller image
    assert np.abs(image - expected)[away].max() < 3.0
