"""Residual, tangent action and blocks of the elastic body, batched over environments.

One thread handles one element of one environment; kernels gather, call the formulas of ``material.py`` and scatter.
Derivatives are by an element's own coordinates xi: its shape functions' are then the same for all elements.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from .element import CORNER_GRADIENTS, Element, tet_geometry
from .material import (
    NeoHookean,
    cofactor,
    first_piola,
    first_piola_increment,
    mat33,
    real,
    tangent_block,
    tangent_transposed,
    tangent_volumetric,
    vec3,
)

wp.set_module_options({"enable_backward": False})

Nodal = wp.types.matrix(shape=(10, 3), dtype=wp.float64)  # one vector for each node of an element


@wp.struct
class Solid:
    """Mesh and material of the body; e elements with q quadrature points."""

    tetrahedra: wp.array2d(dtype=wp.int32)  # (e, nodes)
    gradients: wp.array2d(dtype=vec3)  # (q, nodes) of the shape functions by xi
    inverse: wp.array2d(dtype=mat33)  # (e, q) dxi/dX, 1/mm
    volumes: wp.array2d(dtype=wp.float64)  # (e, q), mm3
    metric: wp.array2d(dtype=mat33)  # (e, q) volume mu dxi/dX dxi/dX^T, see material.first_piola_increment
    pressure_shapes: wp.array2d(dtype=wp.float64)  # (q, 4 or none)
    n_displacements: wp.int32
    mu: real
    gamma: real
    pressure_compliance: real


@wp.struct
class Linearization:
    """The state that the tangent is of, at the quadrature points of every environment: (e, q, env)."""

    cofactors: wp.array3d(dtype=mat33)  # cof dxi/dX^T
    coefficients: wp.array3d(dtype=wp.vec2d)  # volume times alpha and beta


@wp.func
def load_vec3(x: wp.array2d(dtype=wp.float64), node: wp.int32, env: wp.int32) -> vec3:
    return vec3(x[3 * node, env], x[3 * node + 1, env], x[3 * node + 2, env])


@wp.func
def add_vec3(x: wp.array2d(dtype=wp.float64), node: wp.int32, env: wp.int32, value: vec3):
    wp.atomic_add(x, 3 * node, env, value[0])
    wp.atomic_add(x, 3 * node + 1, env, value[1])
    wp.atomic_add(x, 3 * node + 2, env, value[2])


@wp.func
def gather(s: Solid, x: wp.array2d(dtype=wp.float64), e: wp.int32, env: wp.int32) -> Nodal:
    values = Nodal()
    for a in range(s.tetrahedra.shape[1]):
        node = s.tetrahedra[e, a]
        for i in range(3):
            values[a, i] = x[3 * node + i, env]
    return values


@wp.func
def scatter(s: Solid, values: Nodal, e: wp.int32, env: wp.int32, x: wp.array2d(dtype=wp.float64)):
    for a in range(s.tetrahedra.shape[1]):
        for i in range(3):
            wp.atomic_add(x, 3 * s.tetrahedra[e, a] + i, env, values[a, i])


@wp.func
def gather_pressures(s: Solid, x: wp.array2d(dtype=wp.float64), e: wp.int32, env: wp.int32) -> wp.vec4d:
    values = wp.vec4d()
    for b in range(s.pressure_shapes.shape[1]):
        values[b] = x[s.n_displacements + s.tetrahedra[e, b], env]
    return values


@wp.func
def scatter_pressures(s: Solid, values: wp.vec4d, e: wp.int32, env: wp.int32, x: wp.array2d(dtype=wp.float64)):
    for b in range(s.pressure_shapes.shape[1]):
        wp.atomic_add(x, s.n_displacements + s.tetrahedra[e, b], env, values[b])


@wp.func
def local_gradient(s: Solid, values: Nodal, q: wp.int32) -> mat33:
    """Derivative by xi of the field with these nodal values."""
    H = mat33()
    for a in range(s.gradients.shape[1]):
        g = s.gradients[q, a]
        for i in range(3):
            H[i, 0] += values[a, i] * g[0]
            H[i, 1] += values[a, i] * g[1]
            H[i, 2] += values[a, i] * g[2]
    return H


@wp.func
def add_divergence(s: Solid, P: mat33, q: wp.int32, total: Nodal) -> Nodal:
    """The nodal forces of a stress, times volume, that does work on derivatives by xi."""
    for a in range(s.gradients.shape[1]):
        g = s.gradients[q, a]
        for i in range(3):
            total[a, i] += P[i, 0] * g[0] + P[i, 1] * g[1] + P[i, 2] * g[2]
    return total


@wp.func
def at_point(s: Solid, pressures: wp.vec4d, q: wp.int32) -> real:
    p = real(0.0)
    for b in range(s.pressure_shapes.shape[1]):
        p += s.pressure_shapes[q, b] * pressures[b]
    return p


@wp.func
def add_constraint(s: Solid, value: real, q: wp.int32, total: wp.vec4d) -> wp.vec4d:
    for b in range(s.pressure_shapes.shape[1]):
        total[b] += s.pressure_shapes[q, b] * value
    return total


@wp.kernel
def residual_kernel(
    s: Solid,
    x: wp.array2d(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    # outputs
    residual_out: wp.array2d(dtype=wp.float64),
    min_det_out: wp.array(dtype=wp.float64),
):
    e, env = wp.tid()
    if active[env] == 0:
        return
    u, pressures = gather(s, x, e, env), gather_pressures(s, x, e, env)
    forces, constraints = Nodal(), wp.vec4d()
    least = real(1.0e30)
    for q in range(s.volumes.shape[1]):
        F = wp.identity(n=3, dtype=wp.float64) + local_gradient(s, u, q) * s.inverse[e, q]
        p = at_point(s, pressures, q)
        J = wp.determinant(F)
        least = wp.min(least, J)
        P = s.volumes[e, q] * first_piola(F, cofactor(F), J, p, s.mu, s.gamma)
        forces = add_divergence(s, P * wp.transpose(s.inverse[e, q]), q, forces)
        constraint = s.volumes[e, q] * (J - real(1.0) - s.pressure_compliance * p)
        constraints = add_constraint(s, constraint, q, constraints)
    scatter(s, forces, e, env, residual_out)
    scatter_pressures(s, constraints, e, env, residual_out)
    wp.atomic_min(min_det_out, env, least)


@wp.kernel
def linearize_kernel(
    s: Solid,
    x: wp.array2d(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    # outputs
    state_out: Linearization,
):
    e, env = wp.tid()
    if active[env] == 0:
        return
    u, pressures = gather(s, x, e, env), gather_pressures(s, x, e, env)
    for q in range(s.volumes.shape[1]):
        F = wp.identity(n=3, dtype=wp.float64) + local_gradient(s, u, q) * s.inverse[e, q]
        p = at_point(s, pressures, q)
        J = wp.determinant(F)
        alpha = tangent_transposed(J, p, s.mu, s.gamma)
        beta = tangent_volumetric(J, p, s.gamma)
        state_out.cofactors[e, q, env] = cofactor(F) * wp.transpose(s.inverse[e, q])
        state_out.coefficients[e, q, env] = s.volumes[e, q] * wp.vec2d(alpha, beta)


@wp.kernel
def tangent_kernel(
    s: Solid,
    state: Linearization,
    v: wp.array2d(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    # outputs
    action_out: wp.array2d(dtype=wp.float64),
):
    e, env = wp.tid()
    if active[env] == 0:
        return
    du, pressures = gather(s, v, e, env), gather_pressures(s, v, e, env)
    forces, constraints = Nodal(), wp.vec4d()
    for q in range(s.volumes.shape[1]):
        dF = local_gradient(s, du, q)
        dp = at_point(s, pressures, q)
        cof = state.cofactors[e, q, env]
        c = state.coefficients[e, q, env]
        volume = s.volumes[e, q]
        dP = first_piola_increment(dF, cof, s.metric[e, q], c[0], c[1], volume * dp)
        forces = add_divergence(s, dP, q, forces)
        constraint = volume * (wp.ddot(cof, dF) - s.pressure_compliance * dp)
        constraints = add_constraint(s, constraint, q, constraints)
    scatter(s, forces, e, env, action_out)
    scatter_pressures(s, constraints, e, env, action_out)


@wp.kernel
def blocks_kernel(
    s: Solid,
    state: Linearization,
    gradients: wp.array2d(dtype=vec3),
    active: wp.array(dtype=wp.int32),
    block_index: wp.array3d(dtype=wp.int32),
    # outputs
    blocks_out: wp.array2d(dtype=mat33),
):
    e, a, env = wp.tid()
    if active[env] == 0:
        return
    for b in range(gradients.shape[1]):
        K = mat33()
        for q in range(s.volumes.shape[1]):
            c = state.coefficients[e, q, env]
            cof = state.cofactors[e, q, env]
            K += tangent_block(gradients[q, a], gradients[q, b], cof, s.metric[e, q], c[0], c[1])
        wp.atomic_add(blocks_out, block_index[e, a, b], env, K)


@wp.kernel
def diagonal_kernel(
    s: Solid,
    state: Linearization,
    active: wp.array(dtype=wp.int32),
    # outputs
    diagonal_out: wp.array2d(dtype=mat33),
):
    e, a, env = wp.tid()
    if active[env] == 0:
        return
    K = mat33()
    for q in range(s.volumes.shape[1]):
        c = state.coefficients[e, q, env]
        g = s.gradients[q, a]
        K += tangent_block(g, g, state.cofactors[e, q, env], s.metric[e, q], c[0], c[1])
    wp.atomic_add(diagonal_out, s.tetrahedra[e, a], env, K)


class Elasticity:
    """The elastic body: a mesh with its material, seen by the solver as a term (see ``simgen.fem``)."""

    def __init__(self, element: Element, nodes, tetrahedra, n_corners: int, material: NeoHookean, device, active):
        self.material, self.device, self.active = material, device, active
        self.host_nodes, self.n_corners = nodes, n_corners
        self.n_displacements = 3 * len(nodes)
        self.n_pressures = n_corners if element.pressures else 0
        geometry = tet_geometry(element, nodes, tetrahedra)
        self.host_tetrahedra = np.ascontiguousarray(tetrahedra[:, : element.nodes], dtype=np.int32)
        self.pressure_mass = np.zeros(self.n_pressures)  # lumped, mm3
        for b in range(element.pressures):
            shares = geometry.volumes @ geometry.pressure_shapes[:, b]
            np.add.at(self.pressure_mass, tetrahedra[:, b], shares)
        s = self._solid = Solid()
        s.tetrahedra = wp.array(self.host_tetrahedra, dtype=wp.int32, device=device)
        s.gradients = wp.array(geometry.local_gradients, dtype=vec3, device=device)
        linear = np.broadcast_to(CORNER_GRADIENTS, (element.quadrature_points, 4, 3))
        self._linear = wp.array(linear, dtype=vec3, device=device)  # (q, 4), as ``gradients``
        s.inverse = wp.array(geometry.inverse, dtype=mat33, device=device)
        s.volumes = wp.array(geometry.volumes, dtype=wp.float64, device=device)
        metric = np.einsum("eq,eqij,eqkj->eqik", material.mu * geometry.volumes, geometry.inverse, geometry.inverse)
        s.metric = wp.array(metric, dtype=mat33, device=device)
        s.pressure_shapes = wp.array(geometry.pressure_shapes, dtype=wp.float64, device=device)
        s.n_displacements = self.n_displacements
        s.mu, s.gamma, s.pressure_compliance = material.mu, material.gamma, material.pressure_compliance
        points = (*geometry.volumes.shape, active.shape[0])
        self._state = Linearization()
        self._state.cofactors = wp.zeros(points, dtype=mat33, device=device)
        self._state.coefficients = wp.zeros(points, dtype=wp.vec2d, device=device)

    def _launch(self, kernel, inputs, outputs, nodes: int | None = None):
        dim = (len(self.host_tetrahedra), *([] if nodes is None else [nodes]), self.active.shape[0])
        wp.launch(kernel, dim=dim, inputs=[self._solid, *inputs], outputs=outputs, device=self.device)

    def residual(self, x, residual_out, min_det_out):
        """Add the internal forces and the volume constraint; lower ``min_det_out`` (env,) to the least det F."""
        self._launch(residual_kernel, [x, self.active], [residual_out, min_det_out])

    def linearize(self, x):
        """Keep what the derivative at state x needs, for the calls below."""
        self._launch(linearize_kernel, [x, self.active], [self._state])

    def tangent(self, v, action_out):
        """Add the action of the derivative on v."""
        self._launch(tangent_kernel, [self._state, v, self.active], [action_out])

    def blocks(self, block_index, blocks_out, linear: bool):
        """Add the derivative by displacements, or by linear ones alone, as 3 x 3 blocks between nodes or corners."""
        gradients = self._linear if linear else self._solid.gradients
        inputs = [self._state, gradients, self.active, block_index]
        self._launch(blocks_kernel, inputs, [blocks_out], gradients.shape[1])

    def diagonal(self, diagonal_out):
        """Add the 3 x 3 blocks of each node's displacement by itself."""
        self._launch(diagonal_kernel, [self._state, self.active], [diagonal_out], self.host_tetrahedra.shape[1])
