"""The pinhole camera: pixels to rays and back, and images of other sizes."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from simgen.errors import InputError
from simgen.sensors.pinhole import MOST_PIXELS, Pinhole, placed_camera
from simgen.sensors.sensor_geometry import load_geometry
from tests.sensing.camera.scenes import camera, pinhole


def test_axes_are_right_handed_in_the_image():
    """Right x up points back to the viewer, who looks along `forward`."""
    right, up, forward = pinhole().axes
    np.testing.assert_allclose(pinhole().axes @ pinhole().axes.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(np.cross(right, up), -forward, atol=1e-15)
    np.testing.assert_allclose(forward, camera().looks_along)


def test_the_field_of_view_is_that_of_the_image_s_edges():
    """60 degrees from the upper edge of the first row to the lower edge of the last one."""
    of = pinhole(height=64)
    _, up = of.across(np.array([-0.5, 63.5]), np.zeros(2))
    np.testing.assert_allclose(np.degrees(np.arctan(up)), [30.0, -30.0], atol=1e-12)


def test_points_on_a_pixel_s_ray_are_seen_there():
    of, rows, columns = pinhole(), np.array([0, 10, 63]), np.array([47, 3, 20])
    x, y = of.across(rows, columns)
    depth = np.array([0.01, 0.02, 0.05])
    right, up, forward = of.axes
    points = of.position + depth[:, None] * (forward + x[:, None] * right + y[:, None] * up)
    np.testing.assert_allclose(of.in_view(points), np.stack([depth * x, depth * y, depth], axis=1), atol=1e-15)


def test_points_are_projected_to_the_pixels_whose_rays_meet_them():
    of, rows, columns = pinhole(), np.array([0, 10, 63]), np.array([47, 3, 20])
    x, y = of.across(rows, columns)
    depth = np.array([0.01, 0.02, 0.05])
    right, up, forward = of.axes
    points = of.position + depth[:, None] * (forward + x[:, None] * right + y[:, None] * up)
    places, found = of.project(points)
    np.testing.assert_allclose(places, np.stack([columns, rows], axis=1), atol=1e-12)
    np.testing.assert_allclose(found, depth)
    places, found = of.project(of.position - 0.01 * forward)
    assert np.isnan(places).all() and found == pytest.approx(-0.01)


def test_an_image_of_twice_the_size_has_the_same_view():
    one, two = pinhole(64, 48), pinhole(128, 96)
    for corner in ((-0.5, -0.5), (63.5, 47.5)):
        larger = 2.0 * (np.array(corner) + 0.5) - 0.5
        np.testing.assert_allclose(two.across(*larger), one.across(*corner), atol=1e-15)


@pytest.mark.parametrize("size", [(0, 48), (64, MOST_PIXELS + 1)])
def test_a_size_out_of_range_is_one_line(size):
    with pytest.raises(InputError, match=f"image of {size[1]} x {size[0]} pixels: allowed: 1 to {MOST_PIXELS}"):
        Pinhole.of(camera(), *size)


def test_a_sensor_without_a_camera_is_one_line():
    with pytest.raises(InputError, match=r"own/sensor\.yaml: no camera"):
        placed_camera(SimpleNamespace(cameras={}), Path("own"))


def test_a_camera_that_the_sensor_lacks_is_one_line():
    with pytest.raises(InputError, match=r"sensor\.yaml: camera 'front': allowed: default, tacto"):
        placed_camera(load_geometry("digit").description, Path("own"), "front")


def test_the_default_camera_sees_as_much_gel_as_real_ones_and_tacto_29_percent_more():
    """12.8 x 17.1 mm at the apex: the mean of 0.0266 mm a pixel at 480 x 640, and 18.633 pixels a mm at 240 x 320."""
    digit = load_geometry("digit")
    apex = digit.true.surface.vertices[:, 1].min()
    seen = {}
    for name in ("default", "tacto"):
        pinhole = Pinhole.of(placed_camera(digit.description, Path("own"), name))
        away = pinhole.position[1] - apex
        seen[name] = np.array([pinhole.width, pinhole.height]) * away / pinhole.focal
    measured = 0.5 * (0.0266e-3 * np.array([480, 640]) + 1e-3 * np.array([240, 320]) / 18.633)
    np.testing.assert_allclose(seen["default"], measured, rtol=2e-3)
    np.testing.assert_allclose(seen["tacto"], 1.29 * measured, rtol=5e-3)
