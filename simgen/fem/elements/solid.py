"""Mesh and material of the elastic body as kernel arguments: in double precision for forces, single for derivatives."""

from __future__ import annotations

from functools import cache
from typing import Any

import warp as wp

from simgen.fem.columns import number_at
from simgen.fem.material.law import Law
from simgen.fem.material.volume import cofactor
from simgen.fem.precision import mat33, mat33f, single

wp.set_module_options({"enable_backward": False})


LEAST_DAMPED = wp.constant(wp.float32(0.02))  # det F below which damping no longer grows with 1 / det F


@wp.struct
class Solid:
    """Mesh and material in double precision, for forces; e elements with q quadrature points."""

    tetrahedra: wp.array2d(dtype=wp.int32)  # (e, nodes)
    rest: wp.array2d(dtype=mat33)  # (e, 4) dX/dxi at the corners, mm
    shapes: wp.array(dtype=wp.vec4d)  # (q,) linear shape functions
    metric: wp.array2d(dtype=mat33)  # (e, q) mu dxi/dX dxi/dX^T, see `simgen.fem.material.law`
    contraction: wp.array2d(dtype=wp.float64)  # (e, q) det dxi/dX, 1/mm3
    volumes: wp.array2d(dtype=wp.float64)  # (e, q), mm3
    mean_metric: wp.array(dtype=mat33)  # (e,) integral of the metric over the element
    weight: wp.array2d(dtype=wp.float32)  # (e, env) of the stabilisation, see stabilisation.py
    first_pressure: wp.int32
    mu: wp.float64
    constants: wp.vec4d  # of the law beside mu
    gamma: wp.float64
    most_extra: wp.float32  # bound of `extra_gamma`, see stabilisation.py
    pressure_compliance: wp.float64


@wp.struct
class SingleSolid:
    """Mesh and material in single precision, for derivatives."""

    tetrahedra: wp.array2d(dtype=wp.int32)
    shapes: wp.array(dtype=wp.vec4f)
    metric: wp.array2d(dtype=mat33f)
    contraction: wp.array2d(dtype=wp.float32)
    volumes: wp.array2d(dtype=wp.float32)
    mean_metric: wp.array(dtype=mat33f)
    weight: wp.array2d(dtype=wp.float32)
    first_pressure: wp.int32
    mu: wp.float32
    constants: wp.vec4f
    gamma: wp.float32
    most_extra: wp.float32
    pressure_compliance: wp.float32
    damping: wp.array2d(dtype=wp.float32)  # (1, env) eta mu of the damped tangent, see damping.py
    state: wp.array2d(dtype=wp.float32)  # (unknowns, env) deformed positions and pressures: where derivatives are taken


@wp.func
def extra_gamma(weight: single, most: single) -> single:
    """gamma / mu that a stabilised element adds to the material's."""
    return wp.min(weight, most)


@wp.func
def gradient_metric(mean_metric: Any, weight: single):
    """Factor of the deviations of the corners' gradients in a stabilised element's stress, see stabilisation.py.

    1/64 is 1/4 for the mean over the corners times 1/16 of the weight.
    """
    return mean_metric.dtype(weight / single(64.0)) * mean_metric


@cache
def make_modulus(law: type[Law]) -> wp.Function:
    """Function for the law's modulus at a quadrature point, with damping and stabilisation."""

    @wp.func
    def modulus(s: SingleSolid, F: mat33f, p: single, e: wp.int32, q: wp.int32, env: wp.int32):
        J = s.contraction[e, q] * wp.determinant(F)
        cof = s.contraction[e, q] * cofactor(F)
        gamma = s.gamma + s.mu * extra_gamma(number_at(s.weight, e, env), s.most_extra)
        out = law.modulus(F, cof, s.metric[e, q], J, p, s.mu, gamma, s.constants)
        damping = number_at(s.damping, 0, env)
        if damping > single(0.0):
            out.metric += (damping / wp.max(J, LEAST_DAMPED)) * (wp.transpose(out.cofactor) * out.cofactor)
        return out

    return modulus
