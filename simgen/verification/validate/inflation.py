"""Inflation of a thick-walled sphere: the incompressible closed form, and the radial problem of our own laws."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

from simgen.verification.validate.meshes import Mesh
from simgen.verification.validate.reference_law import ReferenceLaw

RELATIVE, ABSOLUTE = 1e-12, 1e-14  # tolerances of the integration


@dataclass(frozen=True)
class Inflation:
    """Pressure inside, E, and radius outside, mm."""

    pressure: float
    outer_radius: float


def incompressible(law: ReferenceLaw, radii: tuple[float, float], inner_stretch: float) -> Inflation:
    """Solve the sphere without change of volume: p = integral of dW/dl / (l^3 - 1) from lo to li.

    li inside and lo outside are the hoop stretches (Green and Zerna, *Theoretical Elasticity*, 2nd ed., chapter 3;
    Ogden, *Non-linear Elastic Deformations*, section 5.3). For the neo-Hookean law this is
    mu/2 [4/lo + 1/lo^4 - 4/li - 1/li^4].
    """
    inner, outer = radii
    outer_radius = (outer**3 + inner**3 * (inner_stretch**3 - 1.0)) ** (1.0 / 3.0)

    def integrand(l: float) -> float:
        return law.slope(2.0 * l**2 + l**-4 - 3.0) * 2.0 * (l**3 + 1.0) / l**5  # dW/dl = 2 slope (l - l^-5)

    pressure, _ = quad(integrand, outer_radius / outer, inner_stretch, epsabs=ABSOLUTE, epsrel=RELATIVE)
    return Inflation(pressure, outer_radius)


def compressible(law: ReferenceLaw, radii: tuple[float, float], inner_stretch: float) -> Inflation:
    """Solve dP_rr/dR = 2 (P_tt - P_rr) / R for our own law, shot from inside until the outer face is free."""
    inner = radii[0]

    def radial_stretch(t: float, radial: float) -> float:
        """Stretch s with P_rr(s, t, t) = radial: for the neo-Hookean law the positive root of a quadratic equation."""
        a, b = law.mu + law.lam * t**4, radial + law.lam * t**2
        s = (b + np.sqrt(b * b + 4.0 * a * law.mu)) / (2.0 * a)
        if not law.constants:
            return s
        return brentq(lambda s: law.principal(s, t)[0] - radial, 0.8 * s, 1.25 * s, xtol=1e-15, rtol=1e-14)

    def slope(radius: float, state: np.ndarray) -> list[float]:
        r, radial = state
        t = r / radius
        s = radial_stretch(t, radial)
        return [s, 2.0 * (law.principal(s, t)[1] - radial) / radius]

    def shoot(radial_inside: float) -> np.ndarray:
        start = [inner * inner_stretch, radial_inside]
        return solve_ivp(slope, radii, start, "DOP853", rtol=RELATIVE, atol=ABSOLUTE).y[:, -1]

    guess = -incompressible(law, radii, inner_stretch).pressure * inner_stretch**2
    radial_inside = brentq(lambda radial: shoot(radial)[1], 1.5 * guess, 0.5 * guess, xtol=1e-14)
    return Inflation(-radial_inside / inner_stretch**2, shoot(radial_inside)[0])


def pressure_from_reactions(mesh: Mesh, inner: np.ndarray, reactions: np.ndarray, inner_stretch: float) -> float:
    """Pressure inside an octant by virtual work: sum of r . X over the inner nodes is p dV/dli, V = pi/6 (li Ri)^3."""
    work = np.sum(reactions[inner] * mesh.nodes[inner])
    radius = np.linalg.norm(mesh.nodes[inner[0]])  # of a corner, for corners come first
    return work / (0.5 * np.pi * inner_stretch**2 * radius**3)
