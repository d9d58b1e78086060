"""Functions of the volume ratio J that all laws share: psi's part -mu ln J + gamma/2 (J - 1)^2 + p (J - 1).

Below J = 1/20 the logarithm is continued by its Taylor polynomial of second order, so that forces are finite where
elements are inverted (Stomakhin, Howes, Schroeder and Teran, *Energetically consistent invertible elasticity*, SCA
2012). Newton's method passes through such states. A sample that ends in one has the status *inside out*.
"""

from __future__ import annotations

from typing import Any

import warp as wp

LEAST_LOGARITHM = wp.constant(0.05)  # J below which the logarithm is continued
LEAST_DIVISOR = wp.constant(1e-3)  # of |J|, where derivatives are divided by it


@wp.func
def cofactor(F: Any):
    """cof F = J F^-T: its columns are cross products of the columns of F (no division, defined for J = 0)."""
    f0 = wp.vector(F[0, 0], F[1, 0], F[2, 0])
    f1 = wp.vector(F[0, 1], F[1, 1], F[2, 1])
    f2 = wp.vector(F[0, 2], F[1, 2], F[2, 2])
    return wp.matrix_from_cols(wp.cross(f1, f2), wp.cross(f2, f0), wp.cross(f0, f1))


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
def tangent_transposed(J: Any, p: Any, mu: Any, gamma: Any):
    """Coefficient alpha of ``cof dF^T cof`` in dP, from d(cof F) = ((cof : dF) cof - cof dF^T cof) / J."""
    return (mu * log_slope(J) - volumetric_stress(J, p, gamma)) / divisor(J)


@wp.func
def tangent_volumetric(J: Any, p: Any, mu: Any, gamma: Any):
    """Coefficient beta of ``(cof : dF) cof`` in dP."""
    return gamma - mu * log_curvature(J) - tangent_transposed(J, p, mu, gamma)
