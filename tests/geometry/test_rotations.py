"""Rotations onto directions: proper and exact."""

import numpy as np

from simgen.geometry.rotations import least_rotations, roll_then_pitch

RNG = np.random.default_rng(1)
DIRECTIONS = RNG.normal(size=(100, 3))
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
UP = np.array([0.0, 1.0, 0.0])


def assert_proper(rotations):
    np.testing.assert_allclose(rotations @ rotations.transpose(0, 2, 1), np.tile(np.eye(3), (len(rotations), 1, 1)),
                               atol=1e-12)  # fmt: skip
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0)


def test_least_rotations_turn_by_the_angle_between_the_directions():
    directions = np.concatenate([DIRECTIONS, [UP, -UP]])
    rotations = least_rotations(directions)
    assert_proper(rotations)
    np.testing.assert_allclose(rotations @ UP, directions, atol=1e-12)
    cosine = 0.5 * (np.trace(rotations, axis1=1, axis2=2) - 1.0)
    np.testing.assert_allclose(cosine, directions @ UP, atol=1e-12)


def test_a_roll_and_a_pitch_turn_sources_onto_targets_without_yaw():
    sources, targets = DIRECTIONS[:50], DIRECTIONS[50:]
    turnable = np.hypot(sources[:, 1], sources[:, 2]) >= np.abs(targets[:, 2])
    rotations = roll_then_pitch(sources, targets)
    assert 10 < turnable.sum() < 50 and np.isnan(rotations[~turnable]).any(axis=(1, 2)).all()
    rotations = rotations[turnable]
    assert_proper(rotations)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", rotations, sources[turnable]), targets[turnable], atol=1e-12)
    np.testing.assert_array_equal(rotations[:, 2, 0], 0.0)  # of R_z R_x
