"""Rotations that turn one direction onto another."""

import numpy as np


def roll_then_pitch(sources: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Rotations R = R_z(pitch) R_x(roll), (n, 3, 3), with R source = target and the smaller of two possible rolls.

    The roll gives a source, of ``sources`` (n, 3), the z of its target, of ``targets`` (n, 3). Both then have the same
    length in xy, and the pitch turns one onto the other. NaN where the yz part of a source is too short.
    """
    in_yz = np.hypot(sources[:, 1], sources[:, 2])
    too_short = np.abs(targets[:, 2]) > in_yz
    y = np.copysign(np.sqrt(np.where(too_short, np.nan, in_yz**2 - targets[:, 2] ** 2)), sources[:, 1])
    roll = np.arctan2(targets[:, 2], y) - np.arctan2(sources[:, 2], sources[:, 1])
    pitch = np.arctan2(targets[:, 1], targets[:, 0]) - np.arctan2(y, sources[:, 0])
    about_x, about_z = (np.tile(np.eye(3), (len(sources), 1, 1)) for _ in range(2))
    for turn, angle, first, second in ((about_x, roll, 1, 2), (about_z, pitch, 0, 1)):
        turn[:, first, first] = turn[:, second, second] = np.cos(angle)
        turn[:, second, first] = np.sin(angle)
        turn[:, first, second] = -turn[:, second, first]
    return about_z @ about_x


def least_rotations(directions: np.ndarray) -> np.ndarray:
    """Least rotations (n, 3, 3) of +y to unit directions (n, 3), by Rodrigues' formula; about x for -y."""
    x, y, z = directions.T
    opposite = y < -1.0 + 1e-12
    scale = 1.0 / np.where(opposite, 1.0, 1.0 + y)
    rotation = np.empty((len(directions), 3, 3))
    rotation[:, 0] = np.stack([1.0 - scale * x * x, x, -scale * x * z], axis=1)
    rotation[:, 1] = np.stack([-x, y, -z], axis=1)
    rotation[:, 2] = np.stack([-scale * x * z, z, 1.0 - scale * z * z], axis=1)
    rotation[opposite] = np.diag([1.0, -1.0, -1.0])
    return rotation
