"""Poses along the press axis."""

import numpy as np
from scipy.spatial.transform import Rotation

from simgen.config.indenter_path import moved
from simgen.sensors.indenter_pose import advanced


def test_an_indenter_moves_along_its_own_y_and_keeps_its_orientation():
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, :3, :3] = Rotation.random(5, random_state=0).as_matrix()
    poses[:, :3, 3] = np.random.default_rng(0).normal(size=(5, 3))
    before, travel = poses.copy(), np.linspace(-1e-3, 2e-3, 5)
    np.testing.assert_allclose(advanced(poses, travel), moved(poses, travel[:, None] * [0.0, 1.0, 0.0]), atol=1e-15)
    np.testing.assert_array_equal(advanced(poses[0], 2.0), advanced(poses, 2.0)[0])
    np.testing.assert_array_equal(poses, before)
