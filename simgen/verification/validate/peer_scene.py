"""The scene that independent codes solve too: what each is told, and what it hands back.

A quarter of the round layer of ``layer_reference``, without friction. Codes share geometry, material, pose and depths;
each has its own mesh, elements, contact and solver.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simgen.verification.validate.layer_reference import MODULUS_MPA, POISSON_RATIO

SPHERE_MM = 3.5
# Of the law W = mu/2 (I1 - 3 - 2 ln J) + lambda/2 (J - 1)^2
SHEAR_MPA = MODULUS_MPA / (2.0 * (1.0 + POISSON_RATIO))
LAME_MPA = 2.0 * SHEAR_MPA * POISSON_RATIO / (1.0 - 2.0 * POISSON_RATIO)


@dataclass(frozen=True)
class PeerSolution:
    """A quarter of the layer pressed by one code, through d depths.

    unknowns : of its linear systems
    seconds : of one core, from the assembled scene to the last depth; of the clock on a GPU
    newton, krylov : iterations, all depths together; krylov 0 with a direct solver
    force : (d,) N on the whole layer; NaN from where it did not converge
    displacement : (d, n, 3) mm, of the points of the surface that it was asked for
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
