"""Poses of an indenter on its way along the press axis."""

import numpy as np


def advanced(pose: np.ndarray, travel: np.ndarray | float) -> np.ndarray:
    """Move poses (..., 4, 4) of an indenter by travel (...), m, along its press direction, +y of its frame."""
    moved = pose.copy()
    moved[..., :3, 3] += np.asarray(travel)[..., None] * pose[..., :3, 1]
    return moved
