"""Neo-Hookean law: W = mu/2 (tr F^T F - 3) (Bonet and Wood, *Nonlinear Continuum Mechanics*, 2nd ed., eq. 6.28)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import warp as wp

from simgen.fem.material.law import Law
from simgen.fem.material.volume import log_slope, tangent_transposed, tangent_volumetric, volumetric_stress
from simgen.fem.precision import mat33f, single


@wp.func
def first_piola(F: Any, cof: Any, metric: Any, J: Any, p: Any, mu: Any, gamma: Any, c: Any):
    """P = mu F + (gamma (J - 1) + p - mu d ln J / dJ) cof F."""
    return F * metric + (volumetric_stress(J, p, gamma) - mu * log_slope(J)) * cof


@wp.func
def cauchy(F: Any, J: Any, p: Any, mu: Any, gamma: Any, c: Any):
    """P F^T / J = mu / J (F F^T - J d ln J / dJ I) + (gamma (J - 1) + p) I."""
    one = wp.diag(wp.vector(type(J)(1.0), type(J)(1.0), type(J)(1.0)))
    return (mu / J) * (F * wp.transpose(F) - (J * log_slope(J)) * one) + volumetric_stress(J, p, gamma) * one


@wp.func
def first_piola_increment(dF: Any, cof: Any, metric: Any, alpha: Any, beta: Any, dp: Any):
    """dP = dF metric + alpha cof dF^T cof + (beta cof : dF + dp) cof."""
    return dF * metric + alpha * (cof * wp.transpose(dF) * cof) + (beta * wp.ddot(cof, dF) + dp) * cof


@wp.func
def tangent_block(ga: Any, gb: Any, cof: Any, metric: Any, alpha: Any, beta: Any):
    """(ga . metric gb) I + alpha hb ha^T + beta ha hb^T with h = cof g, from :func:`first_piola_increment`."""
    ha, hb = cof * ga, cof * gb
    plain = wp.dot(ga, metric * gb)
    return wp.diag(wp.vector(plain, plain, plain)) + alpha * wp.outer(hb, ha) + beta * wp.outer(ha, hb)


@wp.struct
class Modulus:
    """Arguments of :func:`first_piola_increment`."""

    cofactor: mat33f
    metric: mat33f
    alpha: wp.float32
    beta: wp.float32


@wp.func
def modulus(F: Any, cof: Any, metric: Any, J: Any, p: Any, mu: Any, gamma: Any, c: Any):
    out = Modulus()
    out.cofactor = cof
    out.metric = metric
    out.alpha = tangent_transposed(J, p, mu, gamma)
    out.beta = tangent_volumetric(J, p, mu, gamma)
    return out


@wp.func
def increment(dF: mat33f, m: Modulus, dp: single):
    return first_piola_increment(dF, m.cofactor, m.metric, m.alpha, m.beta, dp)


@wp.func
def block(ga: wp.vec3f, gb: wp.vec3f, m: Modulus):
    return tangent_block(ga, gb, m.cofactor, m.metric, m.alpha, m.beta)


@wp.func
def own_block(g: wp.vec3f, m: Modulus, volume: single):
    h = m.cofactor * g
    plain = volume * wp.dot(g, m.metric * g)
    return wp.diag(wp.vec3f(plain, plain, plain)) + wp.outer((volume * (m.alpha + m.beta)) * h, h)


@dataclass(frozen=True)
class NeoHookean(Law):
    """Neo-Hookean solid: E and nu say all."""

    name = "neo_hookean"
    first_piola, cauchy, modulus, increment = first_piola, cauchy, modulus, increment
    block, own_block = block, own_block
