"""Inflation of a thick-walled sphere: the incompressible closed form, and the radial problem of our own law."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from simgen.verification.validate.law import Law
from simgen.verification.validate.meshes import Mesh

RELATIVE, ABSOLUTE = 1e-12, 1e-14  # tolerances of the integration


@dataclass(frozen=True)
class Inflation:
    """Pressure inside, E, and radius outside, mm."""

    pressure: float
    outer_radius: float


def incompressible(mu: float, radii: tuple[float, float], inner_stretch: float) -> Inflation:
    """p = mu/2 [4/lo + 1/lo^4 - 4/li - 1/li^4] with the hoop stretches li inside and lo outside.

    Green and Zerna, *Theoretical Elasticity*, 2nd ed., chapter 3, for the neo-Hookean solid.
    """
    inner, outer = radii
    outer_radius = (outer**3 + inner**3 * (inner_stretch**3 - 1.0)) ** (1.0 / 3.0)

    def potential(stretch: float) -> float:
        return 4.0 / stretch + stretch**-4

    return Inflation(0.5 * mu * (potential(outer_radius / outer) - potential(inner_stretch)), outer_radius)


def compressible(law: Law, radii: tuple[float, float], inner_stretch: float) -> Inflation:
    """Our own law: dP_rr/dR = 2 (P_tt - P_rr) / R, shot from inside until the outer face is free."""
    inner = radii[0]

    def radial_stretch(radius: float, r: float, radial: float) -> float:
        """s with mu (s - 1/s) + lam (s t^2 - 1) t^2 = P_rr, t = r/R: the positive root of a quadratic equation."""
        t2 = (r / radius) ** 2
        a, b = law.mu + law.lam * t2**2, radial + law.lam * t2
        return (b + np.sqrt(b * b + 4.0 * a * law.mu)) / (2.0 * a)

    def slope(radius: float, state: np.ndarray) -> list[float]:
        r, radial = state
        s, t = radial_stretch(radius, r, radial), r / radius
        hoop = law.mu * (t - 1.0 / t) + law.lam * (s * t * t - 1.0) * s * t
        return [s, 2.0 * (hoop - radial) / radius]

    def shoot(radial_inside: float) -> np.ndarray:
        start = [inner * inner_stretch, radial_inside]
        return solve_ivp(slope, radii, start, "DOP853", rtol=RELATIVE, atol=ABSOLUTE).y[:, -1]

    guess = -incompressible(law.mu, radii, inner_stretch).pressure * inner_stretch**2
    radial_inside = brentq(lambda radial: shoot(radial)[1], 1.5 * guess, 0.5 * guess, xtol=1e-14)
    return Inflation(-radial_inside / inner_stretch**2, shoot(radial_inside)[0])


def pressure_from_reactions(mesh: Mesh, inner: np.ndarray, reactions: np.ndarray, inner_stretch: float) -> float:
    """Pressure inside an octant by virtual work: sum of r . X over the inner nodes is p dV/dli, V = pi/6 (li Ri)^3."""
    work = np.sum(reactions[inner] * mesh.nodes[inner])
    radius = np.linalg.norm(mesh.nodes[inner[0]])  # of a corner, for corners come first
    return work / (0.5 * np.pi * inner_stretch**2 * radius**3)
