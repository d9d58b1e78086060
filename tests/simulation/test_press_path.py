"""Path lengths, poses along a path, and the longest load steps."""

import numpy as np

from simgen.simulation.press_path import MAX_STEP_MM, TURN_RADIUS_MM, PressPath, longest_segments, longest_way

PRESS_SHEAR_TURN = np.array([[0.0, 0.1, 0.0, 0.0], [0.0, 0.5, 0.0, 0.0], [0.3, 0.5, 0.0, 0.0], [0.3, 0.5, 0.0, 0.2]])


def test_legs_are_segments_in_one_direction():
    corners = np.array([[0.0, 0.0], [0.0, 0.1], [0.0, 0.3], [0.5, 0.3], [1.5, 0.3], [1.5, 0.1]])
    lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    np.testing.assert_allclose(longest_segments(corners, lengths), [0.2, 0.2, 1.0, 1.0, 0.2])


def test_lengths_add_up_and_steps_are_bounded():
    path = PressPath(PRESS_SHEAR_TURN)
    assert len(path) == 4
    np.testing.assert_allclose(path.lengths, [0.0, 0.1, 0.5, 0.8, 0.8 + 0.2 * TURN_RADIUS_MM])
    np.testing.assert_allclose(path.max_steps, [MAX_STEP_MM, MAX_STEP_MM, MAX_STEP_MM, MAX_STEP_MM])
    np.testing.assert_allclose(PressPath(PRESS_SHEAR_TURN[:1]).max_steps, [0.1])


def test_poses_follow_the_path():
    path, start = PressPath(PRESS_SHEAR_TURN), np.tile(np.eye(4), (3, 1, 1))
    poses = path.poses(start, np.array([0.3, 0.65, path.lengths[-1]]))
    np.testing.assert_allclose(poses[:, :3, 3], [[0.0, 0.3, 0.0], [0.15, 0.5, 0.0], [0.3, 0.5, 0.0]], atol=1e-12)
    np.testing.assert_allclose(poses[:2, :3, :3], start[:2, :3, :3])
    np.testing.assert_allclose(poses[2, 0, 0], np.cos(0.2))
    np.testing.assert_allclose(poses[2, 0, 2], np.sin(0.2))


def test_no_point_goes_further_than_the_longest_way():
    path, reach = PressPath(PRESS_SHEAR_TURN), 7.0
    points = reach * np.array([[np.cos(a), 0.0, np.sin(a)] for a in np.linspace(0.0, 2.0 * np.pi, 12)])
    lengths = np.linspace(0.0, path.lengths[-1], 9)
    poses = path.poses(np.tile(np.eye(4), (9, 1, 1)), lengths)
    at = np.einsum("eij,pj->epi", poses[:, :3, :3], points) + poses[:, None, :3, 3]
    way = np.linalg.norm(np.diff(at, axis=0), axis=2).max(axis=1)
    bound = longest_way(np.diff(path.offsets(lengths), axis=0), np.full(8, reach))
    assert (way <= bound + 1e-12).all() and bound.max() < 2.0 * way.max()
