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

Nodal = wp.types.matrix(shape=(10, 3), dtype=wp.float64)  # one vector for each node of an element


@wp.func
def load_vec3(x: wp.array2d(dtype=wp.float64), node: wp.int32, env: wp.int32) -> vec3:
    return vec3(x[3 * node, env], x[3 * node + 1, env], x[3 * node + 2, env])


@wp.func
def add_vec3(x: wp.array2d(dtype=wp.float64), node: wp.int32, env: wp.int32, value: vec3):
    wp.atomic_add(x, 3 * node, env, value[0])
    wp.atomic_add(x, 3 * node + 1, env, value[1])
    wp.atomic_add(x, 3 * node + 2, env, value[2])


@wp.func
def gather(
    x: wp.array2d(dtype=wp.float64), tetrahedra: wp.array2d(dtype=wp.int32), e: wp.int32, env: wp.int32
) -> Nodal:
    values = Nodal()
    for a in range(tetrahedra.shape[1]):
        node = tetrahedra[e, a]
        for i in range(3):
            values[a, i] = x[3 * node + i, env]
    return values


@wp.func
def scatter(
    x: wp.array2d(dtype=wp.float64),
    tetrahedra: wp.array2d(dtype=wp.int32),
    values: Nodal,
    e: wp.int32,
    env: wp.int32,
):
    for a in range(tetrahedra.shape[1]):
        for i in range(3):
            wp.atomic_add(x, 3 * tetrahedra[e, a] + i, env, values[a, i])


@wp.func
def displacement_gradient(values: Nodal, gradients: wp.array3d(dtype=vec3), e: wp.int32, q: wp.int32) -> mat33:
    H = mat33()
    for a in range(gradients.shape[2]):
        g = gradients[e, q, a]
        for i in range(3):
            H[i, 0] += values[a, i] * g[0]
            H[i, 1] += values[a, i] * g[1]
            H[i, 2] += values[a, i] * g[2]
    return H


@wp.func
def add_divergence(P: mat33, gradients: wp.array3d(dtype=vec3), e: wp.int32, q: wp.int32, total: Nodal) -> Nodal:
    for a in range(gradients.shape[2]):
        g = gradients[e, q, a]
        for i in range(3):
            total[a, i] += P[i, 0] * g[0] + P[i, 1] * g[1] + P[i, 2] * g[2]
    return total


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
    u = gather(x, tetrahedra, e, env)
    forces = Nodal()
    least = real(1.0e30)
    for q in range(volumes.shape[1]):
        F = wp.identity(n=3, dtype=wp.float64) + displacement_gradient(u, gradients, e, q)
        p = pressure_at(x, tetrahedra, pressure_shapes, n_displacements, e, q, env)
        cof = cofactor(F)
        J = wp.determinant(F)
        least = wp.min(least, J)
        forces = add_divergence(volumes[e, q] * first_piola(F, cof, J, p, mu, gamma), gradients, e, q, forces)
        constraint = volumes[e, q] * (J - real(1.0) - pressure_compliance * p)
        for b in range(pressure_shapes.shape[1]):
            row = n_displacements + tetrahedra[e, b]
            wp.atomic_add(residual_out, row, env, pressure_shapes[q, b] * constraint)
    scatter(residual_out, tetrahedra, forces, e, env)
    wp.atomic_min(min_det_out, env, least)


@wp.kernel
def linearize_kernel(
    x: wp.array2d(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    tetrahedra: wp.array2d(dtype=wp.int32),
    gradients: wp.array3d(dtype=vec3),
    volumes: wp.array2d(dtype=wp.float64),
    pressure_shapes: wp.array2d(dtype=wp.float64),
    n_displacements: wp.int32,
    mu: real,
    gamma: real,
    # outputs
    cofactor_out: wp.array3d(dtype=mat33),
    coefficients_out: wp.array3d(dtype=wp.vec2d),
):
    e, env = wp.tid()
    if active[env] == 0:
        return
    u = gather(x, tetrahedra, e, env)
    for q in range(volumes.shape[1]):
        F = wp.identity(n=3, dtype=wp.float64) + displacement_gradient(u, gradients, e, q)
        p = pressure_at(x, tetrahedra, pressure_shapes, n_displacements, e, q, env)
        J = wp.determinant(F)
        alpha = tangent_transposed(J, p, mu, gamma)
        beta = tangent_volumetric(J, p, gamma)
        cofactor_out[e, q, env] = cofactor(F)
        coefficients_out[e, q, env] = wp.vec2d(alpha, beta)


@wp.kernel
def tangent_kernel(
    v: wp.array2d(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    cofactors: wp.array3d(dtype=mat33),
    coefficients: wp.array3d(dtype=wp.vec2d),
    tetrahedra: wp.array2d(dtype=wp.int32),
    gradients: wp.array3d(dtype=vec3),
    volumes: wp.array2d(dtype=wp.float64),
    pressure_shapes: wp.array2d(dtype=wp.float64),
    n_displacements: wp.int32,
    mu: real,
    pressure_compliance: real,
    # outputs
    action_out: wp.array2d(dtype=wp.float64),
):
    e, env = wp.tid()
    if active[env] == 0:
        return
    du = gather(v, tetrahedra, e, env)
    forces = Nodal()
    for q in range(volumes.shape[1]):
        dF = displacement_gradient(du, gradients, e, q)
        dp = pressure_at(v, tetrahedra, pressure_shapes, n_displacements, e, q, env)
        cof = cofactors[e, q, env]
        c = coefficients[e, q, env]
        dP = volumes[e, q] * first_piola_increment(dF, cof, mu, c[0], c[1], dp)
        forces = add_divergence(dP, gradients, e, q, forces)
        constraint = volumes[e, q] * (wp.ddot(cof, dF) - pressure_compliance * dp)
        for b in range(pressure_shapes.shape[1]):
            row = n_displacements + tetrahedra[e, b]
            wp.atomic_add(action_out, row, env, pressure_shapes[q, b] * constraint)
    scatter(action_out, tetrahedra, forces, e, env)


@wp.kernel
def pressure_action_kernel(
    v: wp.array2d(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    cofactors: wp.array3d(dtype=mat33),
    tetrahedra: wp.array2d(dtype=wp.int32),
    gradients: wp.array3d(dtype=vec3),
    volumes: wp.array2d(dtype=wp.float64),
    pressure_shapes: wp.array2d(dtype=wp.float64),
    n_displacements: wp.int32,
    # outputs
    action_out: wp.array2d(dtype=wp.float64),
):
    """The forces of a pressure increment alone: the gradient block B^T of the mixed tangent."""
    e, env = wp.tid()
    if active[env] == 0:
        return
    forces = Nodal()
    for q in range(volumes.shape[1]):
        dp = pressure_at(v, tetrahedra, pressure_shapes, n_displacements, e, q, env)
        forces = add_divergence((volumes[e, q] * dp) * cofactors[e, q, env], gradients, e, q, forces)
    scatter(action_out, tetrahedra, forces, e, env)


@wp.kernel
def blocks_kernel(
    active: wp.array(dtype=wp.int32),
    cofactors: wp.array3d(dtype=mat33),
    coefficients: wp.array3d(dtype=wp.vec2d),
    tetrahedra: wp.array2d(dtype=wp.int32),
    gradients: wp.array3d(dtype=vec3),
    volumes: wp.array2d(dtype=wp.float64),
    mu: real,
    block_index: wp.array3d(dtype=wp.int32),
    # outputs
    blocks_out: wp.array2d(dtype=mat33),
):
    """K_ab = mu (g_a . g_b) I + alpha h_b h_a^T + beta h_a h_b^T with h = cof g, g the shape function gradients."""
    e, env = wp.tid()
    if active[env] == 0:
        return
    for q in range(volumes.shape[1]):
        cof = cofactors[e, q, env]
        alpha = volumes[e, q] * coefficients[e, q, env][0]
        beta = volumes[e, q] * coefficients[e, q, env][1]
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
        points = (*geometry.volumes.shape, active.shape[0])
        self._cofactors = wp.zeros(points, dtype=mat33, device=device)
        self._coefficients = wp.zeros(points, dtype=wp.vec2d, device=device)

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

    def linearize(self, x):
        """Keep what the derivative at state x needs, for the calls below."""
        m = self.material
        inputs = [x, self.active, *self._mesh(), m.mu, m.gamma]
        self._launch(linearize_kernel, inputs, [self._cofactors, self._coefficients])

    def tangent(self, v, action_out):
        """Add the action of the derivative on v."""
        m = self.material
        inputs = [v, self.active, self._cofactors, self._coefficients, *self._mesh(), m.mu, m.pressure_compliance]
        self._launch(tangent_kernel, inputs, [action_out])

    def pressure_action(self, v, action_out):
        """Add the forces of the pressures in v."""
        self._launch(pressure_action_kernel, [v, self.active, self._cofactors, *self._mesh()], [action_out])

    def blocks(self, block_index, blocks_out):
        """Add the displacement part of the derivative, as 3 x 3 blocks."""
        mesh = [self.tetrahedra, self.gradients, self.volumes]
        inputs = [self.active, self._cofactors, self._coefficients, *mesh, self.material.mu, block_index]
        self._launch(blocks_kernel, inputs, [blocks_out])
