"""The press that all codes solve, and the solution that each returns.

A sphere is pressed into a quarter of the round layer of ``layer_reference``, without friction. Codes share geometry,
material, pose and depths. Each has its own mesh, elements, contact and solver.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from simgen.verification.validate.layer_reference import MODULUS_MPA, POISSON_RATIO

T = TypeVar("T")
SPHERE_MM = 3.5
# Law: W = mu/2 (I1 - 3 - 2 ln J) + lambda/2 (J - 1)^2
SHEAR_MPA = MODULUS_MPA / (2.0 * (1.0 + POISSON_RATIO))
LAME_MPA = 2.0 * SHEAR_MPA * POISSON_RATIO / (1.0 - 2.0 * POISSON_RATIO)


@dataclass(frozen=True)
class PeerSolution:
    """Solution of one code at d depths.

    unknowns : size of the linear systems
    seconds : time of one core (on a GPU wall-clock time) from the assembled scene to the last depth
    newton, krylov : total iterations; krylov is 0 for a direct solver
    force : (d,) N on the whole layer; NaN at depths that did not converge
    displacement : (d, n, 3) mm at the given surface points
    """

    code: str
    unknowns: int
    seconds: float
    newton: int
    krylov: int
    force: np.ndarray
    displacement: np.ndarray

    @property
    def converged(self) -> bool:
        return bool(np.isfinite(self.force).all())


def timed(device: str, action: Callable[[], T]) -> tuple[T, float]:
    """Run an action; return its result and its seconds: of one core on a CPU, wall-clock time on a GPU."""
    clock = time.process_time if device == "cpu" else time.perf_counter
    start = clock()
    return action(), clock() - start
