"""Residual, tangent action and block matrix of the elastic body, batched over environments.

One thread handles one element of one environment; kernels gather, call the formulas of ``material.py`` and scatter.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from .element import Element, tet_geometry
from .material import (
    NeoHookean,
    cofactor,
    first_piola,
    first_piola_increment,
    mat33,
    real,
    tangent_transposed,
    tangent_volumetric,
    vec3,
)

wp.set_module_options({"enable_backward": False})


@wp.func
def load_vec3(x: wp.array2d(dtype=wp.float64), node: wp.int32, env: wp.int32) -> vec3:
    return vec3(x[3 * node, env], x[3 * node + 1, env], x[3 * node + 2, env])


@wp.func
def add_vec3(x: wp.array2d(dtype=wp.float64), node: wp.int32, env: wp.int32, value: vec3):
    wp.atomic_add(x, 3 * node, env, value[0])
    wp.atomic_add(x, 3 * node + 1, env, value[1])
    wp.atomic_add(x, 3 * node + 2, env, value[2])


@wp.func
def displacement_gradient(
    x: wp.array2d(dtype=wp.float64),
    tetrahedra: wp.array2d(dtype=wp.int32),
    gradients: wp.array3d(dtype=vec3),
    e: wp.int32,
    q: wp.int32,
    env: wp.int32,
) -> mat33:
    H = mat33()
    for a in range(tetrahedra.shape[1]):
        H += wp.outer(load_vec3(x, tetrahedra[e, a], env), gradients[e, q, a])
    return H


@wp.func
def pressure_at(
    x: wp.array2d(dtype=wp.float64),
    tetrahedra: wp.array2d(dtype=wp.int32),
    pressure_shapes: wp.array2d(dtype=wp.float64),
    n_displacements: wp.int32,
    e: wp.int32,
    q: wp.int32,
    env: wp.int32,
) -> real:
    p = real(0.0)
    for b in range(pressure_shapes.shape[1]):
        p += pressure_shapes[q, b] * x[n_displacements + tetrahedra[e, b], env]
    return p


@wp.kernel
def residual_kernel(
    x: wp.array2d(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    tetrahedra: wp.array2d(dtype=wp.int32),
    gradients: wp.array3d(dtype=vec3),
    volumes: wp.array2d(dtype=wp.float64),
    pressure_shapes: wp.array2d(dtype=wp.float64),
    n_displacements: wp.int32,
    mu: real,
    gamma: real,
    pressure_compliance: real,
    # outputs
    residual_out: wp.array2d(dtype=wp.float64),
    min_det_out: wp.array(dtype=wp.float64),
):
    e, env = wp.tid()
    if active[env] == 0:
        return
    for q in range(volumes.shape[1]):
        F = wp.identity(n=3, dtype=wp.float64) + displacement_gradient(x, tetrahedra, gradients, e, q, env)
        p = pressure_at(x, tetrahedra, pressure_shapes, n_displacements, e, q, env)
        cof = cofactor(F)
        J = wp.determinant(F)
        wp.atomic_min(min_det_out, env, J)
        P = volumes[e, q] * first_piola(F, cof, J, p, mu, gamma)
        for a in range(tetrahedra.shape[1]):
            add_vec3(residual_out, tetrahedra[e, a], env, P * gradients[e, q, a])
        constraint = volumes[e, q] * (J - real(1.0) - pressure_compliance * p)
        for b in range(pressure_shapes.shape[1]):
            row = n_displacements + tetrahedra[e, b]
            wp.atomic_add(residual_out, row, env, pressure_shapes[q, b] * constraint)


@wp.kernel
def tangent_kernel(
    x: wp.array2d(dtype=wp.float64),
    v: wp.array2d(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    tetrahedra: wp.array2d(dtype=wp.int32),
    gradients: wp.array3d(dtype=vec3),
    volumes: wp.array2d(dtype=wp.float64),
    pressure_shapes: wp.array2d(dtype=wp.float64),
    n_displacements: wp.int32,
    mu: real,
    gamma: real,
    pressure_compliance: real,
    # outputs
    action_out: wp.array2d(dtype=wp.float64),
):
    e, env = wp.tid()
    if active[env] == 0:
        return
    for q in range(volumes.shape[1]):
        F = wp.identity(n=3, dtype=wp.float64) + displacement_gradient(x, tetrahedra, gradients, e, q, env)
        dF = displacement_gradient(v, tetrahedra, gradients, e, q, env)
        p = pressure_at(x, tetrahedra, pressure_shapes, n_displacements, e, q, env)
        dp = pressure_at(v, tetrahedra, pressure_shapes, n_displacements, e, q, env)
        cof = cofactor(F)
        J = wp.determinant(F)
        dP = volumes[e, q] * first_piola_increment(dF, cof, J, p, dp, mu, gamma)
        for a in range(tetrahedra.shape[1]):
            add_vec3(action_out, tetrahedra[e, a], env, dP * gradients[e, q, a])
        constraint = volumes[e, q] * (wp.ddot(cof, dF) - pressure_compliance * dp)
        for b in range(pressure_shapes.shape[1]):
            row = n_displacements + tetrahedra[e, b]
            wp.atomic_add(action_out, row, env, pressure_shapes[q, b] * constraint)


@wp.kernel
def blocks_kernel(
    x: wp.array2d(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    tetrahedra: wp.array2d(dtype=wp.int32),
    gradients: wp.array3d(dtype=vec3),
    volumes: wp.array2d(dtype=wp.float64),
    pressure_shapes: wp.array2d(dtype=wp.float64),
    n_displacements: wp.int32,
    mu: real,
    gamma: real,
    block_index: wp.array3d(dtype=wp.int32),
    # outputs
    blocks_out: wp.array2d(dtype=mat33),
):
    """K_ab = mu (g_a . g_b) I + alpha h_b h_a^T + beta h_a h_b^T with h = cof g, g the shape function gradients."""
    e, env = wp.tid()
    if active[env] == 0:
        return
    for q in range(volumes.shape[1]):
        F = wp.identity(n=3, dtype=wp.float64) + displacement_gradient(x, tetrahedra, gradients, e, q, env)
        p = pressure_at(x, tetrahedra, pressure_shapes, n_displacements, e, q, env)
        cof = cofactor(F)
        J = wp.determinant(F)
        alpha = volumes[e, q] * tangent_transposed(J, p, mu, gamma)
        beta = volumes[e, q] * tangent_volumetric(J, p, gamma)
        for a in range(tetrahedra.shape[1]):
            ga = gradients[e, q, a]
            ha = cof * ga
            for b in range(tetrahedra.shape[1]):
                gb = gradients[e, q, b]
                hb = cof * gb
                K = alpha * wp.outer(hb, ha) + beta * wp.outer(ha, hb)
                K += (volumes[e, q] * mu * wp.dot(ga, gb)) * wp.identity(n=3, dtype=wp.float64)
                wp.atomic_add(blocks_out, block_index[e, a, b], env, K)


class Elasticity:
    """The elastic body: a mesh with its material, seen by the solver as a term (see ``simgen.fem``)."""

    def __init__(self, element: Element, nodes, tetrahedra, n_corners: int, material: NeoHookean, device, active):
        self.material, self.device, self.active = material, device, active
        self.n_displacements = 3 * len(nodes)
        self.n_pressures = n_corners if element.pressures else 0
        geometry = tet_geometry(element, nodes, tetrahedra)
        self.host_tetrahedra = np.ascontiguousarray(tetrahedra[:, : element.nodes], dtype=np.int32)
        self.tetrahedra = wp.array(self.host_tetrahedra, dtype=wp.int32, device=device)
        self.gradients = wp.array(geometry.gradients, dtype=vec3, device=device)
        self.volumes = wp.array(geometry.volumes, dtype=wp.float64, device=device)
        self.pressure_shapes = wp.array(geometry.pressure_shapes, dtype=wp.float64, device=device)
        self.pressure_mass = np.zeros(self.n_pressures)  # lumped, mm3
        for b in range(element.pressures):
            shares = geometry.volumes @ geometry.pressure_shapes[:, b]
            np.add.at(self.pressure_mass, tetrahedra[:, b], shares)
        self.volume = float(geometry.volumes.sum())

    def _mesh(self):
        return [self.tetrahedra, self.gradients, self.volumes, self.pressure_shapes, self.n_displacements]

    def _launch(self, kernel, inputs, outputs):
        dim = (self.tetrahedra.shape[0], self.active.shape[0])
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self.device)

    def residual(self, x, residual_out, min_det_out):
        """Add the internal forces and the volume constraint; lower ``min_det_out`` (env,) to the least det F."""
        m = self.material
        inputs = [x, self.active, *self._mesh(), m.mu, m.gamma, m.pressure_compliance]
        self._launch(residual_kernel, inputs, [residual_out, min_det_out])

    def tangent(self, x, v, action_out):
        m = self.material
        inputs = [x, v, self.active, *self._mesh(), m.mu, m.gamma, m.pressure_compliance]
        self._launch(tangent_kernel, inputs, [action_out])

    def blocks(self, x, block_index, blocks_out):
        m = self.material
        inputs = [x, self.active, *self._mesh(), m.mu, m.gamma, block_index]
        self._launch(blocks_kernel, inputs, [blocks_out])
