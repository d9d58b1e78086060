"""Kernels of the residual and of the tangent's action, made for each material law and kind of device.

An element's function gathers what it needs of one environment, calls the law's functions at the quadrature points, and
scatters. Derivatives are by an element's coordinates xi and are kept at its four corners (``element_fields.py``). So an
element is read and written once, and a quadrature point costs as much as one of a linear element. The tangent
recomputes its moduli from the state. On one CPU core it would be a fifth faster if it stored them. But they take 350
bytes per element and environment, more than all other data that it moves.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import warp as wp

from simgen.fem.batch_arrays import Envs, Scalars, SingleVectors, Vectors
from simgen.fem.columns import number_at
from simgen.fem.elements.element_fields import (
    corner_gradients,
    corner_pressures,
    interpolate,
    scatter_gradients,
    scatter_pressures,
    without_mean,
)
from simgen.fem.elements.side_by_side import make_group_action, make_group_forces
from simgen.fem.elements.solid import SingleSolid, Solid, extra_gamma, gradient_metric, make_modulus
from simgen.fem.groups import group_at
from simgen.fem.material.law import Law, law_module
from simgen.fem.material.neo_hookean import NeoHookean
from simgen.fem.material.volume import cofactor
from simgen.fem.precision import mat33, mat33f, real, single

wp.set_module_options({"enable_backward": False})

# Per GPU thread: with 128, some numbers lie in memory. A tangent of 512 presses then takes 2.51 us a press instead of
# 2.29 with four points of an element, and 3.19 instead of 3.17 with eight (one H100).
TANGENT_REGISTERS = 168


@wp.func
def stabilise(
    s: Any, da: Any, db: Any, dc: Any, dd: Any, Pa: Any, Pb: Any, Pc: Any, Pd: Any, e: wp.int32, env: wp.int32
):
    """Stresses P at the corners with those that gradients d cause in a stabilised element, see stabilisation.py."""
    weight = s.weight[e, env]
    if weight > single(0.0):
        M = gradient_metric(s.mean_metric[e], weight)
        a, b, c, d = without_mean(da, db, dc, dd)
        Pa += a * M
        Pb += b * M
        Pc += c * M
        Pd += d * M
    return Pa, Pb, Pc, Pd


@wp.func
def element_gamma(s: Solid, e: wp.int32, env: wp.int32):
    """gamma of an element with its stabilisation."""
    return s.gamma + s.mu * real(extra_gamma(number_at(s.weight, e, env), s.most_extra))


@cache
def point_functions(law: type[Law]) -> tuple[wp.Function, wp.Function]:
    """Functions of a law at quadrature point q of element e: stress and volume, and how they change."""
    modulus = make_modulus(law)

    @wp.func(name=f"stress_at_{law.name}")
    def stress_at(s: Solid, F: mat33, p: real, gamma: real, e: wp.int32, q: wp.int32):
        """Stress, error of the volume constraint, and det F."""
        J = s.contraction[e, q] * wp.determinant(F)
        cof = s.contraction[e, q] * cofactor(F)
        P = law.first_piola(F, cof, s.metric[e, q], J, p, s.mu, gamma, s.constants)
        return P, J - real(1.0) - s.pressure_compliance * p, J

    @wp.func(name=f"increment_at_{law.name}")
    def increment_at(
        s: SingleSolid, F: mat33f, dF: mat33f, p: single, dp: single, e: wp.int32, q: wp.int32, env: wp.int32
    ):
        """Changes of stress and of the volume constraint with dF and dp."""
        m = modulus(s, F, p, e, q, env)
        return law.increment(dF, m, dp), wp.ddot(m.cofactor, dF) - s.pressure_compliance * dp

    return stress_at, increment_at


@cache
def element_functions(law: type[Law]) -> tuple[wp.Function, wp.Function]:
    """Functions that add an element's forces, and its tangent's action, in one environment."""
    stress_at, increment_at = point_functions(law)

    @wp.func(name=f"element_forces_{law.name}")
    def forces(s: Solid, x: Vectors, e: wp.int32, env: wp.int32, residual: Vectors, min_det: Scalars):
        ua, ub, uc, ud = corner_gradients(s.tetrahedra, x, e, env)
        Fa, Fb, Fc, Fd = s.rest[e, 0] + ua, s.rest[e, 1] + ub, s.rest[e, 2] + uc, s.rest[e, 3] + ud
        pressures = corner_pressures(s.tetrahedra, x, s.first_pressure, e, env)
        Pa, Pb, Pc, Pd = mat33(), mat33(), mat33(), mat33()
        constraints = wp.vec4d()
        least, gamma = real(1.0e30), element_gamma(s, e, env)
        for q in range(s.volumes.shape[1]):
            shapes = s.shapes[q]
            F = interpolate(shapes, Fa, Fb, Fc, Fd)
            P, constraint, J = stress_at(s, F, wp.dot(shapes, pressures), gamma, e, q)
            least = wp.min(least, J)
            weights = s.volumes[e, q] * shapes
            Pa += weights[0] * P
            Pb += weights[1] * P
            Pc += weights[2] * P
            Pd += weights[3] * P
            constraints += constraint * weights
        Pa, Pb, Pc, Pd = stabilise(s, ua, ub, uc, ud, Pa, Pb, Pc, Pd, e, env)
        scatter_gradients(s.tetrahedra, Pa, Pb, Pc, Pd, e, env, residual)
        scatter_pressures(s.tetrahedra, constraints, s.first_pressure, e, env, residual)
        wp.atomic_min(min_det, env, least)

    @wp.func(name=f"element_action_{law.name}")
    def action(s: SingleSolid, v: SingleVectors, e: wp.int32, env: wp.int32, action: SingleVectors):
        Fa, Fb, Fc, Fd = corner_gradients(s.tetrahedra, s.state, e, env)
        da, db, dc, dd = corner_gradients(s.tetrahedra, v, e, env)
        pressures = corner_pressures(s.tetrahedra, s.state, s.first_pressure, e, env)
        increments = corner_pressures(s.tetrahedra, v, s.first_pressure, e, env)
        Pa, Pb, Pc, Pd = mat33f(), mat33f(), mat33f(), mat33f()
        constraints = wp.vec4f()
        for q in range(s.volumes.shape[1]):
            shapes = s.shapes[q]
            F, dF = interpolate(shapes, Fa, Fb, Fc, Fd), interpolate(shapes, da, db, dc, dd)
            dP, constraint = increment_at(s, F, dF, wp.dot(shapes, pressures), wp.dot(shapes, increments), e, q, env)
            weights = s.volumes[e, q] * shapes
            Pa += weights[0] * dP
            Pb += weights[1] * dP
            Pc += weights[2] * dP
            Pd += weights[3] * dP
            constraints += constraint * weights
        Pa, Pb, Pc, Pd = stabilise(s, da, db, dc, dd, Pa, Pb, Pc, Pd, e, env)
        scatter_gradients(s.tetrahedra, Pa, Pb, Pc, Pd, e, env, action)
        scatter_pressures(s.tetrahedra, constraints, s.first_pressure, e, env, action)

    return forces, action


@cache
def operator_kernels(law: type[Law]) -> tuple[tuple[wp.Kernel, wp.Kernel], tuple[wp.Kernel, wp.Kernel]]:
    """Kernels of the residual and of the tangent's action for a law, each for CPUs and for GPUs."""
    return tuple(zip(_cpu_kernels(law), _gpu_kernels(law), strict=True))


def _gpu_kernels(law: type[Law]) -> tuple[wp.Kernel, wp.Kernel]:
    module, (forces, action) = law_module(__name__, law, "gpu"), element_functions(law)

    @wp.kernel(module=module)
    def residual_kernel(s: Solid, x: Vectors, active: Envs, residual_out: Vectors, min_det_out: Scalars):
        e, lane = wp.tid()
        env = active[lane]
        if env >= 0:
            forces(s, x, e, env, residual_out, min_det_out)

    @wp.kernel(module=module, cuda_max_registers=TANGENT_REGISTERS)
    def tangent_kernel(s: SingleSolid, v: SingleVectors, active: Envs, action_out: SingleVectors):
        e, lane = wp.tid()
        env = active[lane]
        if env >= 0:
            action(s, v, e, env, action_out)

    return residual_kernel, tangent_kernel


def _cpu_kernels(law: type[Law]) -> tuple[wp.Kernel, wp.Kernel]:
    """Kernels that compute groups of environments side by side; linear elements are computed one by one."""
    module, (forces, action) = law_module(__name__, law, "cpu"), element_functions(law)
    stress_at, increment_at = point_functions(law)
    group_forces = make_group_forces(stress_at, element_gamma, stabilise)
    group_action = make_group_action(increment_at, stabilise)

    @wp.kernel(module=module)
    def residual_kernel(s: Solid, x: Vectors, active: Envs, residual_out: Vectors, min_det_out: Scalars):
        e, lane = wp.tid(), wp.int32(0)
        first, count, group = group_at(active, lane, x.shape[1])
        while count > 0:
            if group == 0 or s.tetrahedra.shape[1] != 10:
                for k in range(lane, lane + count):
                    forces(s, x, e, active[k], residual_out, min_det_out)
            else:
                group_forces(s, x, e, first, group, residual_out, min_det_out)
            lane += count
            first, count, group = group_at(active, lane, x.shape[1])

    @wp.kernel(module=module)
    def tangent_kernel(s: SingleSolid, v: SingleVectors, active: Envs, action_out: SingleVectors):
        e, lane = wp.tid(), wp.int32(0)
        first, count, group = group_at(active, lane, v.shape[1])
        while count > 0:
            if group == 0 or s.tetrahedra.shape[1] != 10:
                for k in range(lane, lane + count):
                    action(s, v, e, active[k], action_out)
            else:
                group_action(s, v, e, first, group, action_out)
            lane += count
            first, count, group = group_at(active, lane, v.shape[1])

    return residual_kernel, tangent_kernel


operator_kernels(NeoHookean)  # the default law's kernels are loaded with all others
