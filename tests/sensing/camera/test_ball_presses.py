"""Simulated presses of a ball at places of a picture."""

from dataclasses import replace

import numpy as np
import pytest

from simgen.sensing.camera.ball_presses import BallPresses, contact_pose
from simgen.sensing.camera.spheres import Circle
from simgen.sensors.sensor import load_sensor

PLACES = [Circle(29.5, 39.5, 5.0), Circle(14.0, 52.0, 5.0)]  # the middle of the image, and aside


@pytest.fixture(scope="module")
def sensor():
    return load_sensor("digit", "coarse")


@pytest.fixture(scope="module")
def presses(sensor):
    camera = replace(sensor.cameras["default"], width_px=60, height_px=80)
    return BallPresses.simulate(sensor, camera, PLACES, 3e-3, np.array([0.3e-3, 0.6e-3]))


def test_the_dent_lies_at_the_place_and_grows_with_the_depth(presses):
    for number, place in enumerate(PLACES):
        height = presses.height(number, 0.6e-3)
        row, column = np.unravel_index(height.argmax(), height.shape)
        assert np.hypot(row - place.row, column - place.column) < 3.0
        assert 0.4e-3 < height.max() < 0.65e-3
        assert 0.4 * height.max() < presses.height(number, 0.3e-3).max() < 0.6 * height.max()


def test_heights_meet_the_simulated_ones_and_end_at_the_last(presses):
    for depth, stored in zip((0.3e-3, 0.6e-3, 5e-3), (0, 1, 1), strict=True):
        np.testing.assert_allclose(presses.height(0, depth), 1e-7 * presses.heights[0, stored], atol=1e-9)
    assert not presses.height(0, 0.0).any()


def test_heights_between_depths_are_exact_for_parabolas_of_the_depth(presses):
    """Away from the first and the last depth, whose differences are one-sided."""
    depths = 1e-4 * np.arange(1, 6)
    steps = np.round(1e5 * depths + 1e9 * depths**2).astype(np.int16)
    made = replace(presses, heights=np.broadcast_to(steps[None, :, None, None], (1, 5, 80, 60)), depths_m=depths)
    found = made.height(0, 2.5e-4)
    np.testing.assert_allclose(found, 1e-7 * (1e5 * 2.5e-4 + 1e9 * 2.5e-4**2), atol=1e-7)


def test_a_shift_moves_the_dent(presses):
    height, moved = presses.height(0, 0.6e-3), presses.height(0, 0.6e-3, right=4.0, down=-3.0)
    np.testing.assert_allclose(moved[5:-8, 8:-8], height[8:-5, 4:-12], atol=1e-9)


def test_the_pose_is_a_rotation_whose_tip_lies_on_the_gel_and_faces_it(sensor, presses):
    for place in PLACES:
        pose = contact_pose(sensor, presses.pinhole, presses.rest_depth, place)
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
        from_gel = np.linalg.norm(sensor.surface.triangles_center - pose[:3, 3], axis=1)
        assert from_gel.min() < 0.4e-3
        assert pose[1, 1] > 0.9  # the pad looks to -y, so the indenter presses along +y
