"""Kernels for the forces of a contact and its tangent, as an action on vectors and as blocks.

The formulas are in ``traction.py``. A face is read and written once: the forces of its nodes are summed over its points
before they are scattered. The tangent is stored for points that touch, in the order of the candidates, so that
environments, whose candidates differ, lie side by side.
"""

from __future__ import annotations

import warp as wp

from simgen.fem.batch_arrays import Envs, IndexTable, SingleVectors, Vectors
from simgen.fem.blocks import Blocks, add_block, block, store_block
from simgen.fem.contact.traction import (
    FACE_NODES,
    Surface,
    candidate_face,
    face_point,
    face_positions,
    face_vectors,
    traction_at,
)
from simgen.fem.device import large_kernel
from simgen.fem.elements.element_fields import gather, scatter
from simgen.fem.precision import mat33f, real, single, vec3f

wp.set_module_options({"enable_backward": False})

face_vectors_f = wp.types.matrix(shape=(FACE_NODES, 3), dtype=wp.float32)


@large_kernel
def contact_residual_kernel(
    s: Surface, x: Vectors, active: Envs,
    # outputs
    residual_out: Vectors, sums_out: wp.array2d(dtype=wp.vec4d),
):
    """Add forces, and integrals of edge (t - lambda, tau - lambda_t) times the multiplier shape functions."""
    k, lane = wp.tid()
    env = active[lane]
    f = candidate_face(s, k, env)
    if f < 0:
        return
    nodes = face_positions(s, x, f, env)
    forces = face_vectors()
    first, second, third = wp.vec4d(), wp.vec4d(), wp.vec4d()
    touches = wp.bool(False)
    for q in range(s.areas.shape[1]):
        found = traction_at(s, face_point(nodes, s.shapes, q), f, q, env)
        if found.pressure > real(0.0) or found.multiplier > real(0.0):
            touches = True
            force = s.areas[f, q] * (found.pressure * found.normal + found.friction)
            for a in range(FACE_NODES):
                if a < s.shapes.shape[1]:
                    forces[a] = forces[a] - s.shapes[q, a] * force
            slip = found.friction - found.tangential
            missing = (s.edges[f] * s.areas[f, q]) * wp.vec4d(
                found.pressure - found.multiplier, slip[0], slip[1], slip[2]
            )
            first += s.multiplier_shapes[q, 0] * missing
            second += s.multiplier_shapes[q, 1] * missing
            third += s.multiplier_shapes[q, 2] * missing
    if touches:
        for a in range(FACE_NODES):
            if a < s.shapes.shape[1]:
                scatter(s.faces, forces[a], f, a, env, residual_out)
        wp.atomic_add(sums_out, s.slots[f, 0], env, first)
        wp.atomic_add(sums_out, s.slots[f, 1], env, second)
        wp.atomic_add(sums_out, s.slots[f, 2], env, third)


@large_kernel
def contact_tangent_kernel(s: Surface, x: Vectors, active: Envs, tangent_out: Blocks, touching_out: IndexTable):
    """Store the tangent at points that touch, and the points, a bit each: they serve many Krylov iterations."""
    k, lane = wp.tid()
    env = active[lane]
    f = candidate_face(s, k, env)
    if f < 0:
        return
    nodes = face_positions(s, x, f, env)
    touching = wp.int32(0)
    for q in range(s.areas.shape[1]):
        found = traction_at(s, face_point(nodes, s.shapes, q), f, q, env)
        if found.pressure > real(0.0):
            touching |= 1 << q
            store_block(tangent_out, k * s.areas.shape[1] + q, env, mat33f(s.areas[f, q] * found.tangent))
    touching_out[k, env] = touching


@wp.func
def touching_points(s: Surface, touching: IndexTable, k: wp.int32, env: wp.int32) -> wp.int32:
    """Points of candidate k that touch, a bit each; 0 if there is no such candidate or environment (env < 0)."""
    if candidate_face(s, k, env) < 0:
        return 0
    return touching[k, env]


@wp.func
def touches_at(touching: wp.int32, q: wp.int32) -> wp.bool:
    return ((touching >> q) & 1) == 1


@wp.kernel
def contact_action_kernel(
    s: Surface, tangent: Blocks, touching: IndexTable, v: SingleVectors, active: Envs,
    # outputs
    action_out: SingleVectors,
):
    k, lane = wp.tid()
    env = active[lane]
    points = touching_points(s, touching, k, env)
    if points == 0:
        return
    f = s.candidates[k, env]
    nodes = face_vectors_f()
    forces = face_vectors_f()
    for a in range(FACE_NODES):
        if a < s.shapes.shape[1]:
            nodes[a] = gather(s.faces, v, f, a, env)
    for q in range(s.areas.shape[1]):
        if touches_at(points, q):
            dx = vec3f()
            for a in range(FACE_NODES):
                if a < s.shapes.shape[1]:
                    dx += single(s.shapes[q, a]) * nodes[a]
            df = block(tangent, k * s.areas.shape[1] + q, env) * dx
            for a in range(FACE_NODES):
                if a < s.shapes.shape[1]:
                    forces[a] = forces[a] + single(s.shapes[q, a]) * df
    for a in range(FACE_NODES):
        if a < s.shapes.shape[1]:
            scatter(s.faces, forces[a], f, a, env, action_out)


@wp.func
def face_block(
    tangent: Blocks, points: wp.int32, shapes: wp.array2d(dtype=wp.float64),
    k: wp.int32, a: wp.int32, b: wp.int32, env: wp.int32,
) -> mat33f:
    """Tangent between two of a face's shape functions (q, node)."""
    total = mat33f()
    for q in range(shapes.shape[0]):
        if touches_at(points, q):
            total += single(shapes[q, a] * shapes[q, b]) * block(tangent, k * shapes.shape[0] + q, env)
    return total


@wp.kernel
def contact_blocks_kernel(
    s: Surface, tangent: Blocks, touching: IndexTable, shapes: wp.array2d(dtype=wp.float64), active: Envs,
    block_index: wp.array3d(dtype=wp.int32),
    # outputs
    blocks_out: Blocks,
):
    k, lane = wp.tid()
    env = active[lane]
    points = touching_points(s, touching, k, env)
    if points == 0:
        return
    f = s.candidates[k, env]
    for a in range(shapes.shape[1]):
        for b in range(shapes.shape[1]):
            K = face_block(tangent, points, shapes, k, a, b, env)
            add_block(blocks_out, block_index[f, a, b], env, K)


@wp.kernel
def contact_diagonal_kernel(s: Surface, tangent: Blocks, touching: IndexTable, active: Envs, diagonal_out: Blocks):
    k, lane = wp.tid()
    env = active[lane]
    points = touching_points(s, touching, k, env)
    if points == 0:
        return
    f = s.candidates[k, env]
    for a in range(s.shapes.shape[1]):
        add_block(diagonal_out, s.faces[f, a], env, face_block(tangent, points, s.shapes, k, a, a, env))
