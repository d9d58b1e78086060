"""Near-incompressible neo-Hookean solid with its volumetric stiffness split in two.

Energy per unit of rest volume (Bonet and Wood, *Nonlinear Continuum Mechanics*, 2nd ed., eq. 6.28, with
lam/2 (J - 1)^2 as the volumetric part)::

    psi(F) = mu/2 (tr F^T F - 3 - 2 ln J) + lam/2 (J - 1)^2

With lam = gamma + (lam - gamma), only the second part is enforced through the continuous pressure p, so that ::

    psi(F, p) = mu/2 (tr F^T F - 3 - 2 ln J) + gamma/2 (J - 1)^2 + p (J - 1) - p^2 / (2 (lam - gamma))

Eliminating p pointwise returns psi(F): the split changes how one and the same material is discretised, and keeps the
displacement block definite in deep presses (as "grad-div" stabilisation does for incompressible flow).

Below J = 1/20 the logarithm is continued by its Taylor polynomial of second order, so that a state has finite forces
even where elements are inside out (Stomakhin, Howes, Schroeder and Teran, *Energetically consistent invertible
elasticity*, SCA 2012). Newton's method passes through such states on its way. A sample that ends in one is marked as
inside out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import warp as wp


@dataclass(frozen=True)
class NeoHookean:
    """Parameters of the solid in solver units."""

    mu: float
    lam: float
    gamma: float
    pressure_compliance: float  # 1 / (lam - gamma); 0 where the element carries no pressure

    @classmethod
    def from_engineering(cls, youngs_modulus: float, poisson_ratio: float, split: float | None) -> NeoHookean:
        """Lame parameters from E and nu; ``split`` = gamma/mu, or None for all of lam pointwise (no pressure).

        gamma stays below lam/2, so that the pressure keeps a finite stiffness for compressible solids too. Raises
        ValueError unless 0 < nu < 0.5.
        """
        if not 0.0 < poisson_ratio < 0.5:
            raise ValueError(f"poisson_ratio = {poisson_ratio}, allowed: above 0 and below 0.5")
        mu = youngs_modulus / (2.0 * (1.0 + poisson_ratio))
        lam = 2.0 * mu * poisson_ratio / (1.0 - 2.0 * poisson_ratio)
        if split is None:
            return cls(mu, lam, gamma=lam, pressure_compliance=0.0)
        gamma = min(split * mu, 0.5 * lam)
        return cls(mu, lam, gamma, pressure_compliance=1.0 / (lam - gamma))


@wp.func
def cofactor(F: Any):
    """cof F = J F^-T: its columns are cross products of the columns of F (no division, defined for J = 0)."""
    f0 = wp.vector(F[0, 0], F[1, 0], F[2, 0])
    f1 = wp.vector(F[0, 1], F[1, 1], F[2, 1])
    f2 = wp.vector(F[0, 2], F[1, 2], F[2, 2])
    return wp.matrix_from_cols(wp.cross(f1, f2), wp.cross(f2, f0), wp.cross(f0, f1))


LEAST_LOGARITHM = wp.constant(0.05)  # J below which the logarithm is continued
LEAST_DIVISOR = wp.constant(1e-3)  # of |J|, where derivatives are divided by it


@wp.func
def log_slope(J: Any):
    """d ln J / dJ, continued below `LEAST_LOGARITHM`."""
    nearest = wp.max(J, type(J)(LEAST_LOGARITHM))
    return (type(J)(2.0) * nearest - J) / (nearest * nearest)


@wp.func
def log_curvature(J: Any):
    """Second derivative of the same function."""
    nearest = wp.max(J, type(J)(LEAST_LOGARITHM))
    return -type(J)(1.0) / (nearest * nearest)


@wp.func
def divisor(J: Any):
    """J, but no nearer to zero than `LEAST_DIVISOR`."""
    return wp.sign(J) * wp.max(wp.abs(J), type(J)(LEAST_DIVISOR))


@wp.func
def volumetric_stress(J: Any, p: Any, gamma: Any):
    """gamma (J - 1) + p."""
    return gamma * (J - type(J)(1.0)) + p


@wp.func
def first_piola(F: Any, cof: Any, metric: Any, J: Any, p: Any, mu: Any, gamma: Any):
    """dpsi/dF = mu F + (gamma (J - 1) + p - mu d ln J / dJ) cof F, with metric = mu I.

    In other coordinates xi of the rest shape, with g = dxi/dX and F_xi = dx/dxi, the same formula holds for the stress
    that does work on derivatives by xi, with mu g g^T and cof F g^T = cof F_xi / det (dX/dxi).
    """
    return F * metric + (volumetric_stress(J, p, gamma) - mu * log_slope(J)) * cof


@wp.func
def cauchy(F: Any, J: Any, p: Any, mu: Any, gamma: Any):
    """P F^T / J = mu / J (F F^T - J d ln J / dJ I) + (gamma (J - 1) + p) I."""
    one = wp.diag(wp.vector(type(J)(1.0), type(J)(1.0), type(J)(1.0)))
    return (mu / J) * (F * wp.transpose(F) - (J * log_slope(J)) * one) + volumetric_stress(J, p, gamma) * one


@wp.func
def tangent_transposed(J: Any, p: Any, mu: Any, gamma: Any):
    """Coefficient alpha of ``cof dF^T cof`` in dP; see :func:`first_piola_increment`."""
    return (mu * log_slope(J) - volumetric_stress(J, p, gamma)) / divisor(J)


@wp.func
def tangent_volumetric(J: Any, p: Any, mu: Any, gamma: Any):
    """Coefficient beta of ``(cof : dF) cof`` in dP; see :func:`first_piola_increment`."""
    return gamma - mu * log_curvature(J) - tangent_transposed(J, p, mu, gamma)


@wp.func
def first_piola_increment(dF: Any, cof: Any, metric: Any, alpha: Any, beta: Any, dp: Any):
    """dP = dF metric + alpha cof dF^T cof + (beta cof : dF + dp) cof, with metric as in :func:`first_piola`.

    From d(cof F) = ((cof : dF) cof - cof dF^T cof) / J.
    """
    return dF * metric + alpha * (cof * wp.transpose(dF) * cof) + (beta * wp.ddot(cof, dF) + dp) * cof


@wp.func
def tangent_block(ga: Any, gb: Any, cof: Any, metric: Any, alpha: Any, beta: Any):
    """What node b's displacement does to node a's force, by the gradients of their shape functions.

    (ga . metric gb) I + alpha hb ha^T + beta ha hb^T with h = cof g, from :func:`first_piola_increment`.
    """
    ha, hb = cof * ga, cof * gb
    plain = wp.dot(ga, metric * gb)
    return wp.diag(wp.vector(plain, plain, plain)) + alpha * wp.outer(hb, ha) + beta * wp.outer(ha, hb)
