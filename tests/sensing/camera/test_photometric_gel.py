"""Pictures under the photometric model, and tables that explain shapes that they were not fitted to.

A table knows the tilt that a contact adds. It does not know the gel's own tilt, up to 18 degrees on a DIGIT, except by
its polynomials of the position. So it is exact on a flat and distant gel, and somewhat off on the dome.
"""

import numpy as np
import pytest

from simgen.errors import InputError
from simgen.sensing.camera.photometric_gel import PhotometricGel, photometry_of
from simgen.sensing.camera.photometry import Photometry
from simgen.sensing.camera.spheres import Circle, Patch, sphere_in
from simgen.sensing.camera.table_fit import Observations, fit_response, observe, table_error
from tests.sensing.camera import scenes

pytestmark = pytest.mark.filterwarnings("error")


@pytest.fixture(scope="module")
def table(digit):
    return fit_response(digit.of_patch(patch) for patch in digit.spheres(2**9))


def flat_gel(far: float = 1.0) -> PhotometricGel:
    """A gel across the camera's axis; lights are ``far`` times as far away as usual."""
    of = scenes.pinhole(320, 240)
    camera = scenes.camera(320, 240)
    lights = np.array([camera.position + far * (camera.lights[c] - camera.position) for c in ("red", "green", "blue")])
    lights = lights - (far - 1.0) * scenes.DISTANCE_M * of.axes[2]
    return PhotometricGel(np.full((320, 240), scenes.DISTANCE_M), of, Photometry(lights))


def whole(rendered: PhotometricGel, depth: np.ndarray) -> Observations:
    """Observations of the picture of a coat at ``depth``, where it is at least a micrometre off the gel at rest."""
    rows, columns = np.nonzero(depth < rendered.rest_depth - 1e-6)
    change = rendered.picture(depth) - rendered.background
    return observe(Patch(rows, columns, depth[rows, columns]), rendered.rest_depth, rendered.pinhole.focal, change)


def away(rendered: PhotometricGel, row: float, column: float) -> tuple[np.ndarray, np.ndarray]:
    """Distances of pixels from a place, m, downwards and to the right."""
    rows, columns = np.mgrid[: rendered.pinhole.height, : rendered.pinhole.width]
    pixel = rendered.rest_depth[int(row), int(column)] / rendered.pinhole.focal
    return pixel * (rows - row), pixel * (columns - column)


def ridges(rendered: PhotometricGel) -> np.ndarray:
    """Slanting ridges all over the image, 0.2 mm high, 2 mm wide."""
    down, right = away(rendered, 160, 120)
    return rendered.rest_depth - 2e-4 * np.sin(np.pi * (0.6 * down + 0.8 * right) / 1e-3) ** 2


def cone(rendered: PhotometricGel) -> np.ndarray:
    """1 mm high, its sides as steep as 35 degrees."""
    down, right = away(rendered, 200, 100)
    return rendered.rest_depth - np.maximum(1e-3 - 0.7 * np.hypot(down, right), 0.0)


def bump(rendered: PhotometricGel) -> np.ndarray:
    """Smooth, oblong: 0.8 mm high, 2 mm and 4 mm wide."""
    down, right = away(rendered, 130, 140)
    return rendered.rest_depth - 8e-4 * np.exp(-((down / 1e-3) ** 2) - (right / 2e-3) ** 2)


def test_the_gel_at_rest_is_the_background(digit):
    np.testing.assert_array_equal(digit.picture(digit.rest_depth), digit.background)
    assert digit.background.max() == pytest.approx(digit.photometry.brightest)
    assert digit.background.min() >= digit.photometry.brightest * digit.photometry.ambient


def test_the_background_is_lambert_s_at_a_place_of_a_flat_gel():
    rendered = flat_gel()
    of, row, column = rendered.pinhole, 40, 200
    x, y = of.across(np.array(row), np.array(column))
    point = scenes.in_sensor(scenes.DISTANCE_M * np.array([x, y, 1.0]), of)
    radiance = rendered.photometry.radiance(point, -of.axes[2])
    expected = rendered.photometry.image(radiance, rendered.exposure)
    np.testing.assert_allclose(rendered.background[row, column], expected, rtol=1e-9)


def test_a_part_of_a_picture_is_that_of_the_whole(digit):
    circle = Circle(120.0, 150.0, 20.0)
    patch = sphere_in(circle, 2e-3, digit.rest_depth, digit.pinhole)
    found = digit.of_patch(patch)
    depth = np.full_like(digit.rest_depth, np.nan)
    depth[patch.rows, patch.columns] = patch.depth
    change = digit.picture(depth) - digit.background
    expected = observe(patch, digit.rest_depth, digit.pinhole.focal, change)
    np.testing.assert_allclose(found.change, expected.change, rtol=1e-9)
    assert np.isfinite(found.change).all() and len(found.x) > 0.8 * np.pi * 20.0**2


def test_spheres_are_all_over_the_gel_and_steep():
    half = flat_gel()
    half = PhotometricGel(np.where(np.arange(240) < 120, half.rest_depth, np.inf), half.pinhole, half.photometry)
    patches = list(half.spheres(2**7))
    assert 50 <= len(patches) <= 64  # of 128, half of which are beside the gel
    columns = np.concatenate([patch.columns for patch in patches])
    assert columns.max() == 119 and columns.min() < 10
    assert (half.background[:, 120:] == 0.0).all() and np.isfinite(half.background).all()
    tilts = np.concatenate([np.arctan(np.hypot(o.slope_x, o.slope_y)) for o in map(half.of_patch, patches)])
    assert np.isfinite(tilts).all() and np.degrees(tilts.max()) > 75.0


def test_on_a_flat_gel_with_far_lights_the_table_is_exact():
    """A tilt then has one colour all over the image. Half a bin, 1.5 of 360 degrees, is 2.5 % of a tilt's colour, and
    colours are interpolated between bins.
    """
    rendered = flat_gel(far=50.0)
    table = fit_response(rendered.of_patch(patch) for patch in rendered.spheres(2**9))
    others = [rendered.of_patch(patch) for patch in rendered.spheres(2**4, seed=1)]
    found = table_error(table, others)
    assert found.residual < 0.02 * found.change


def test_the_table_explains_other_spheres(digit, table):
    found = table_error(table, [digit.of_patch(patch) for patch in digit.spheres(2**5, seed=1)])
    assert found.change > 20.0 and found.residual < 0.1 * found.change


@pytest.mark.parametrize("shape", [ridges, cone, bump])
def test_the_table_explains_other_shapes(digit, table, shape):
    """The dome causes an error of a tenth of the change of spheres, and of more for shapes that are less steep."""
    found = table_error(table, [whole(digit, shape(digit))])
    assert found.change > 5.0 and found.residual < 0.15 * found.change


def test_lights_are_red_green_and_blue():
    camera = scenes.camera()
    np.testing.assert_array_equal(photometry_of(camera).lights[0], camera.lights["red"])
    del camera.lights["blue"]
    with pytest.raises(InputError, match="camera: lights red, green: allowed: red, green, blue, one each"):
        photometry_of(camera)
