"""The gel's material law once more, in numpy and with no split and no pressure: what closed forms are made of.

psi(F) = mu/2 (tr F^T F - 3 - 2 ln J) + lam/2 (J - 1)^2 in units of E; every function takes complex F too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

COMPLEX_STEP = 1e-30  # derivatives by Im f(x + i h) / h have no truncation and no cancellation (Squire and Trapp 1998)


@dataclass(frozen=True)
class Law:
    """A neo-Hookean solid with E = 1."""

    poisson_ratio: float

    @property
    def mu(self) -> float:
        return 0.5 / (1.0 + self.poisson_ratio)

    @property
    def lam(self) -> float:
        return 2.0 * self.mu * self.poisson_ratio / (1.0 - 2.0 * self.poisson_ratio)

    def first_piola(self, F: np.ndarray) -> np.ndarray:
        """P = mu (F - F^-T) + lam (J - 1) J F^-T, for F (..., 3, 3)."""
        J = np.linalg.det(F)[..., None, None]
        inverse_transposed = np.swapaxes(np.linalg.inv(F), -1, -2)
        return self.mu * (F - inverse_transposed) + self.lam * (J - 1.0) * J * inverse_transposed

    def body_force(self, gradient, points: np.ndarray) -> np.ndarray:
        """-Div P (..., 3), E/mm, of the deformation whose F (..., 3, 3) at points (..., 3) is ``gradient(points)``."""
        force = np.zeros(points.shape)
        for j, step in enumerate(1j * COMPLEX_STEP * np.eye(3)):
            force -= self.first_piola(gradient(points + step))[..., :, j].imag / COMPLEX_STEP
        return force

    def uniaxial(self, stretch: float) -> tuple[float, float]:
        """Nominal stress along the pull, E, and lateral stretch of a bar with free sides."""

        def sideways(lateral: float) -> float:
            J = stretch * lateral**2
            return self.mu * (lateral - 1.0 / lateral) + self.lam * (J - 1.0) * J / lateral

        lateral = brentq(sideways, 0.2, 5.0, xtol=1e-15, rtol=1e-15)
        J = stretch * lateral**2
        return self.mu * (stretch - 1.0 / stretch) + self.lam * (J - 1.0) * J / stretch, lateral
