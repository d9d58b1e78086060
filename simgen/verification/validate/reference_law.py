"""The material laws once more, in numpy, without split and pressure: the reference for closed forms.

psi(F) = mu/2 s + C20 s^2 + C30 s^3 - mu ln J + lam/2 (J - 1)^2 with s = tr F^T F - 3, in units of E. Without C20 and
C30 it is neo-Hookean, with them Yeoh's law. Functions of F accept complex F.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

COMPLEX_STEP = 1e-30  # derivatives by Im f(x + i h) / h have no truncation and no cancellation (Squire and Trapp 1998)


@dataclass(frozen=True)
class ReferenceLaw:
    """A neo-Hookean or Yeoh solid with E = 1."""

    poisson_ratio: float
    c20: float = 0.0
    c30: float = 0.0

    def __str__(self) -> str:
        return f"nu = {self.poisson_ratio}" + (", Yeoh" if self.constants else "")

    @property
    def name(self) -> str:
        """Key of `simgen.fem.material.LAWS`."""
        return "yeoh" if self.constants else "neo_hookean"

    @property
    def constants(self) -> dict[str, float]:
        """Constants beside E and nu."""
        return {"c20": self.c20, "c30": self.c30} if self.c20 or self.c30 else {}

    @property
    def mu(self) -> float:
        return 0.5 / (1.0 + self.poisson_ratio)

    @property
    def lam(self) -> float:
        """Coefficient of the volumetric part: C20 adds 8 C20 to Lame's first parameter at rest."""
        return 2.0 * self.mu * self.poisson_ratio / (1.0 - 2.0 * self.poisson_ratio) - 8.0 * self.c20

    def energy(self, F: np.ndarray):
        """psi of one F (3, 3)."""
        s, J = np.sum(F * F) - 3.0, np.linalg.det(F)
        shape = 0.5 * self.mu * s + self.c20 * s**2 + self.c30 * s**3
        return shape - self.mu * np.log(J) + 0.5 * self.lam * (J - 1.0) ** 2

    def slope(self, s):
        """Factor of F in the stress: 2 dpsi/ds."""
        return self.mu + 4.0 * self.c20 * s + 6.0 * self.c30 * s**2

    def first_piola(self, F: np.ndarray) -> np.ndarray:
        """P = slope F - mu F^-T + lam (J - 1) J F^-T, for F (..., 3, 3)."""
        J = np.linalg.det(F)[..., None, None]
        inverse_transposed = np.swapaxes(np.linalg.inv(F), -1, -2)
        s = np.sum(F * F, axis=(-2, -1))[..., None, None] - 3.0
        return self.slope(s) * F + (self.lam * (J - 1.0) * J - self.mu) * inverse_transposed

    def body_force(self, gradient, points: np.ndarray) -> np.ndarray:
        """-Div P (..., 3), E/mm, of the deformation whose F (..., 3, 3) at points (..., 3) is ``gradient(points)``."""
        force = np.zeros(points.shape)
        for j, step in enumerate(1j * COMPLEX_STEP * np.eye(3)):
            force -= self.first_piola(gradient(points + step))[..., :, j].imag / COMPLEX_STEP
        return force

    def principal(self, along: float, across: float) -> tuple[float, float]:
        """Nominal stresses, E, along and across, at the principal stretches ``along``, ``across``, ``across``."""
        J, slope = along * across**2, self.slope(along**2 + 2.0 * across**2 - 3.0)
        volumetric = self.lam * (J - 1.0) * J - self.mu
        return slope * along + volumetric / along, slope * across + volumetric / across

    def uniaxial(self, stretch: float) -> tuple[float, float]:
        """Nominal stress along the pull, E, and lateral stretch of a bar with free sides."""
        lateral = brentq(lambda across: self.principal(stretch, across)[1], 0.2, 5.0, xtol=1e-15, rtol=1e-15)
        return self.principal(stretch, lateral)[0], lateral


YEOH = ReferenceLaw(0.499, c20=0.02, c30=0.005)  # a third stiffer than at rest in simple shear of 1
LAWS = (ReferenceLaw(0.3), ReferenceLaw(0.499), YEOH)  # of most cases
