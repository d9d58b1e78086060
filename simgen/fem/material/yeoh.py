"""Yeoh law: W = mu/2 s + C20 s^2 + C30 s^3 with s = tr F^T F - 3 (Yeoh, Rubber Chem. Technol. 66, 1993).

C20 and C30 let a silicone stiffen at large strains. With both zero, this is the neo-Hookean law. As in that law, s is
computed from F itself and not from its isochoric part. So the volumetric part, its split and the pressure stay as they
are, and W is a polynomial that is finite where elements are inverted. Nearly incompressible gels hardly feel the
difference. At rest W resists a change of volume by 8 C20. lam is smaller by as much, so that E and nu are those of
small strains.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import warp as wp

from simgen.fem.material import neo_hookean
from simgen.fem.material.law import Law
from simgen.fem.material.volume import log_slope, tangent_transposed, tangent_volumetric, volumetric_stress
from simgen.fem.precision import mat33f, single


@wp.func
def stiffening(s: Any, mu: Any, c: Any):
    """2 dW/ds / mu, with C20 = c[0], C30 = c[1]: 1 at rest."""
    return type(s)(1.0) + s * (type(s)(4.0) * c[0] + type(s)(6.0) * s * c[1]) / mu


@wp.func
def stiffening_slope(s: Any, mu: Any, c: Any):
    """Factor of A (A : dF) in dP, with A = mu F: 4 d2W/ds2 / mu^2."""
    return (type(s)(8.0) * c[0] + type(s)(24.0) * s * c[1]) / (mu * mu)


@wp.func
def shape_strain(F: Any, A: Any, mu: Any):
    """s = tr F^T F - 3, with A = F metric."""
    return wp.ddot(F, A) / mu - type(mu)(3.0)


@wp.func
def first_piola(F: Any, cof: Any, metric: Any, J: Any, p: Any, mu: Any, gamma: Any, c: Any):
    """P = 2 dW/ds F + (gamma (J - 1) + p - mu d ln J / dJ) cof F."""
    A = F * metric
    return stiffening(shape_strain(F, A, mu), mu, c) * A + (volumetric_stress(J, p, gamma) - mu * log_slope(J)) * cof


@wp.func
def cauchy(F: Any, J: Any, p: Any, mu: Any, gamma: Any, c: Any):
    """P F^T / J."""
    one = wp.diag(wp.vector(type(J)(1.0), type(J)(1.0), type(J)(1.0)))
    slope = stiffening(wp.ddot(F, F) - type(J)(3.0), mu, c)
    return (mu / J) * (slope * (F * wp.transpose(F)) - (J * log_slope(J)) * one) + volumetric_stress(J, p, gamma) * one


@wp.func
def first_piola_increment(
    dF: Any, cof: Any, metric: Any, alpha: Any, beta: Any, dp: Any, A: Any, slope: Any
):
    """dP = that of the neo-Hookean law with a stiffer metric + slope (A : dF) A."""
    plain = neo_hookean.first_piola_increment(dF, cof, metric, alpha, beta, dp)
    return plain + (slope * wp.ddot(A, dF)) * A


@wp.struct
class YeohModulus:
    """Arguments of :func:`first_piola_increment`."""

    cofactor: mat33f
    metric: mat33f
    alpha: wp.float32
    beta: wp.float32
    A: mat33f
    slope: wp.float32


@wp.func
def modulus(F: Any, cof: Any, metric: Any, J: Any, p: Any, mu: Any, gamma: Any, c: Any):
    out = YeohModulus()
    out.A = F * metric
    s = shape_strain(F, out.A, mu)
    out.cofactor = cof
    out.metric = stiffening(s, mu, c) * metric
    out.alpha = tangent_transposed(J, p, mu, gamma)
    out.beta = tangent_volumetric(J, p, mu, gamma)
    out.slope = stiffening_slope(s, mu, c)
    return out


@wp.func
def increment(dF: mat33f, m: YeohModulus, dp: single):
    return first_piola_increment(dF, m.cofactor, m.metric, m.alpha, m.beta, dp, m.A, m.slope)


@wp.func
def block(ga: wp.vec3f, gb: wp.vec3f, m: YeohModulus):
    plain = neo_hookean.tangent_block(ga, gb, m.cofactor, m.metric, m.alpha, m.beta)
    return plain + wp.outer(m.slope * (m.A * ga), m.A * gb)


@wp.func
def own_block(g: wp.vec3f, m: YeohModulus, volume: single):
    return volume * block(g, g, m)


@dataclass(frozen=True)
class Yeoh(Law):
    """Yeoh solid: E, nu, and two constants in units of stress."""

    c20: float = 0.0
    c30: float = 0.0

    name = "yeoh"
    first_piola, cauchy, modulus, increment = first_piola, cauchy, modulus, increment
    block, own_block = block, own_block

    @classmethod
    def lam_of_shape(cls, mu: float, c20: float = 0.0, c30: float = 0.0) -> float:
        return 8.0 * c20

    @property
    def kernel_constants(self) -> tuple[float, float]:
        return self.c20, self.c30
