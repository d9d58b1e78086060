"""Forces of a rig between simulated values of the material: interpolated, so that a fit costs a few presses."""

from collections.abc import Iterator
from itertools import product

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from simgen.calibration.parameters import PRESSED
from simgen.calibration.rig import Rig

DEPTHS = 20


class ForceTable:
    """Forces of a rig for any depth and any values of some free parameters; the others are fixed.

    depth_mm : (d,) mm, simulated depths (`depths_to`)

    Logarithms of forces are interpolated: between knots of a parameter by monotone cubic polynomials (Fritsch and
    Butland, SIAM J. Sci. Stat. Comput. 5, 1984), then by a cubic spline of the logarithm of depth. Below the first
    simulated depth, forces follow the power of depth that they have there.
    """

    def __init__(self, rig: Rig, fixed: dict[str, float], free: tuple[str, ...], depth_mm: np.ndarray):
        self.rig, self.fixed = rig, fixed
        self.free = tuple(name for name in free if name in PRESSED)
        self.depth_mm = depth_mm
        axes = [PRESSED[name].knots for name in self.free]
        shape = [len(knots) for knots in axes]
        curves = [rig.press(values, self.depth_mm) for values in needed(fixed, self.free)]
        self._log_force = np.log([curve.force for curve in curves]).reshape(*shape, -1)
        self._mesh_error = np.array([curve.mesh_error for curve in curves]).reshape(*shape, -1)
        self._first = [PchipInterpolator(axes[0], self._log_force)] if axes else []

    def force(self, values: dict[str, float], depth_mm: np.ndarray) -> np.ndarray:
        """Forces (n,) N per Pa of E at depths (n,) mm; 0 at depths of 0 and less."""
        logs = self._at(self._log_force, values, self._first)
        touched = np.maximum(depth_mm, 1e-9)
        spline = CubicSpline(np.log(self.depth_mm), logs)
        first, below = np.log(self.depth_mm[0]), np.log(touched) < np.log(self.depth_mm[0])
        log_force = np.where(below, logs[0] + spline(first, 1) * (np.log(touched) - first), spline(np.log(touched)))
        return np.where(depth_mm > 0.0, np.exp(log_force), 0.0)

    def mesh_error(self, values: dict[str, float], depth_mm: np.ndarray) -> np.ndarray:
        """Estimated errors (n,) of the mesh, as shares of the forces."""
        return np.interp(depth_mm, self.depth_mm, self._at(self._mesh_error, values))

    def _at(self, table: np.ndarray, values: dict[str, float], first: list[PchipInterpolator] = ()) -> np.ndarray:
        """A table over knots and depths, at values of the free parameters: (d,)."""
        for number, name in enumerate(self.free):
            along = first[0] if first and not number else PchipInterpolator(PRESSED[name].knots, table)
            table = along(values[name])
        return table


def depths_to(deepest_mm: float, share: float = 0.0) -> np.ndarray:
    """Simulated depths (d,) mm: evenly spaced, to the deepest measured one and a share of it."""
    return deepest_mm * (1.0 + share) * np.arange(1, DEPTHS + 1) / DEPTHS


def needed(fixed: dict[str, float], free: tuple[str, ...]) -> Iterator[dict[str, float]]:
    """Values of the presses of a table, all combinations of knots of its free parameters."""
    names = [name for name in free if name in PRESSED]
    for knots in product(*(PRESSED[name].knots for name in names)):
        yield fixed | dict(zip(names, knots, strict=True))
