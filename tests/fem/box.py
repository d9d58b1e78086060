"""The box that the tests of the solver press, hold and bend, and points of its elements."""

import numpy as np

from simgen.verification.validate.meshes import box, top

__all__ = ["box", "lattice", "top"]


def lattice(n: int) -> np.ndarray:
    """Barycentric points (p, 4) whose coordinates are whole multiples of 1 / n: 20 for n = 3."""
    return np.array([p for p in np.ndindex(n + 1, n + 1, n + 1, n + 1) if sum(p) == n]) / n
