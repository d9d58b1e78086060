"""Stress and tangent of a law at single points, evaluated by the functions that kernels call."""

from functools import cache

import numpy as np
import warp as wp

from simgen.fem.material import neo_hookean, yeoh
from simgen.fem.material.law import MOST_CONSTANTS, Law, law_module
from simgen.fem.material.neo_hookean import NeoHookean
from simgen.fem.material.volume import cofactor, tangent_transposed, tangent_volumetric
from simgen.fem.material.yeoh import Yeoh
from simgen.fem.precision import mat33, mat33f, real, vec3f

MU, GAMMA, P = 0.7, 1.3, 0.4
SOLIDS = (NeoHookean(MU, 100.0, GAMMA, 0.01), Yeoh(MU, 100.0, GAMMA, 0.01, c20=0.05, c30=0.02))


@wp.func
def neo_hookean_tangent(F: mat33, dF: mat33, cof: mat33, metric: mat33, alpha: real, beta: real, dp: real, c: wp.vec4d):
    return neo_hookean.first_piola_increment(dF, cof, metric, alpha, beta, dp)


@wp.func
def yeoh_tangent(F: mat33, dF: mat33, cof: mat33, metric: mat33, alpha: real, beta: real, dp: real, c: wp.vec4d):
    A = F * metric
    mu = metric[0, 0]
    s = yeoh.shape_strain(F, A, mu)
    slope = yeoh.stiffening_slope(s, mu, c)
    return yeoh.first_piola_increment(dF, cof, yeoh.stiffening(s, mu, c) * metric, alpha, beta, dp, A, slope)


TANGENTS = {NeoHookean: neo_hookean_tangent, Yeoh: yeoh_tangent}


@cache
def point_kernels(law: type[Law]) -> tuple[wp.Kernel, wp.Kernel]:
    tangent, module = TANGENTS[law], law_module(__name__, law)

    @wp.kernel(module=module, enable_backward=False)
    def stress_kernel(
        F: wp.array(dtype=mat33),
        dF: wp.array(dtype=mat33),
        c: wp.vec4d,
        p: wp.float64,
        dp: wp.float64,
        mu: wp.float64,
        gamma: wp.float64,
        P_out: wp.array(dtype=mat33),
        dP_out: wp.array(dtype=mat33),
        cauchy_out: wp.array(dtype=mat33),
    ):
        i = wp.tid()
        J, cof = wp.determinant(F[i]), cofactor(F[i])
        metric = mu * wp.identity(n=3, dtype=wp.float64)
        P_out[i] = law.first_piola(F[i], cof, metric, J, p, mu, gamma, c)
        alpha, beta = tangent_transposed(J, p, mu, gamma), tangent_volumetric(J, p, mu, gamma)
        dP_out[i] = tangent(F[i], dF[i], cof, metric, alpha, beta, dp, c)
        cauchy_out[i] = law.cauchy(F[i], J, p, mu, gamma, c)

    @wp.kernel(module=module, enable_backward=False)
    def modulus_kernel(
        F: mat33f,
        dF: mat33f,
        ga: vec3f,
        gb: vec3f,
        metric: mat33f,
        c: wp.vec4f,
        p: wp.float32,
        dp: wp.float32,
        mu: wp.float32,
        gamma: wp.float32,
        out: wp.array(dtype=mat33f),
    ):
        m = law.modulus(F, cofactor(F), metric, wp.determinant(F), p, mu, gamma, c)
        out[0] = law.increment(dF, m, dp)
        out[1] = law.block(ga, gb, m)
        out[2] = law.own_block(ga, m, wp.float32(0.5))

    return stress_kernel, modulus_kernel


def padded(solid: Law) -> np.ndarray:
    return np.pad(solid.kernel_constants, (0, MOST_CONSTANTS - len(solid.kernel_constants)))


def stress(solid: Law, F, dF=None, p=P, dp=0.0):
    """First Piola stress, its change with dF and dp, and Cauchy stress, each (3, 3), in double precision."""
    arrays = [wp.array(np.array(a, dtype=float)[None], dtype=mat33, device="cpu") for a in (F, F if dF is None else dF)]
    out = [wp.zeros(1, dtype=mat33, device="cpu") for _ in range(3)]
    inputs = [*arrays, wp.vec4d(*padded(solid)), p, dp, solid.mu, solid.gamma]
    wp.launch(point_kernels(type(solid))[0], dim=1, inputs=inputs, outputs=out, device="cpu")
    return [each.numpy()[0] for each in out]


def tangent(solid: Law, F, dF, ga, gb, metric, p=P, dp=0.0):
    """dP, the block of two nodes and half the block of the first with itself, in single precision."""
    out = wp.zeros(3, dtype=mat33f, device="cpu")
    inputs = [mat33f(F), mat33f(dF), vec3f(*ga), vec3f(*gb), mat33f(metric), wp.vec4f(*padded(solid))]
    wp.launch(point_kernels(type(solid))[1], dim=1, inputs=[*inputs, p, dp, solid.mu, solid.gamma], outputs=[out],
              device="cpu")  # fmt: skip
    return out.numpy()
