"""Kernels for results of a contact: gaps, forces and moments, overlap. The formulas are in ``traction.py``."""

from __future__ import annotations

import warp as wp

from simgen.fem.batch_arrays import Envs, Scalars, Vectors
from simgen.fem.contact.traction import (
    Surface,
    candidate_face,
    face_point,
    face_positions,
    gap_at,
    gap_lower_bound,
    shape_distance,
    traction_at,
)
from simgen.fem.device import large_kernel
from simgen.fem.precision import real, vec3

wp.set_module_options({"enable_backward": False})

SLIDING = wp.constant(wp.float64(1.0 - 1e-9))  # a point slides from this share of the cone's radius on; rounding


@large_kernel
def gap_kernel(s: Surface, x: Vectors, active: Envs, gap_out: wp.array3d(dtype=wp.float64)):
    f, q, lane = wp.tid()
    env = active[lane]
    if env >= 0:
        gap_out[f, q, env] = gap_at(s, face_point(face_positions(s, x, f, env), s.shapes, q), f, q, env)


@large_kernel
def resultant_kernel(
    s: Surface, x: Vectors, active: Envs,
    # outputs
    force_out: wp.array(dtype=vec3), moment_out: wp.array(dtype=vec3), sums_out: Vectors,
):
    """Force and moment on the sensor. Rows of ``sums_out``: contact area, integral of g^2 over it, max -g, and the
    contact area that slides.
    """
    k, lane = wp.tid()
    env = active[lane]
    f = candidate_face(s, k, env)
    if f < 0:
        return
    nodes = face_positions(s, x, f, env)
    for q in range(s.areas.shape[1]):
        found = traction_at(s, face_point(nodes, s.shapes, q), f, q, env)
        if found.pressure > real(0.0):
            area = s.areas[f, q]
            force = area * (found.pressure * found.normal + found.friction)
            wp.atomic_add(force_out, env, force)
            wp.atomic_add(moment_out, env, wp.cross(found.position, force))
            wp.atomic_add(sums_out, 0, env, area)
            wp.atomic_add(sums_out, 1, env, area * found.gap * found.gap)
            wp.atomic_max(sums_out, 2, env, -found.gap)
            if wp.length(found.friction) >= SLIDING * s.friction * found.pressure:
                wp.atomic_add(sums_out, 3, env, area)


@large_kernel
def corner_forces_kernel(
    s: Surface, x: Vectors, active: Envs, first: wp.int32,
    # outputs
    force_out: wp.array3d(dtype=wp.float64),
):
    """Forces (slot, component, lane) on the sensor, distributed to corners by the faces' linear shape functions.

    Lane 0 is the environment ``active[first]``.
    """
    k, lane = wp.tid()
    env = active[first + lane]
    f = candidate_face(s, k, env)
    if f < 0:
        return
    nodes = face_positions(s, x, f, env)
    for q in range(s.areas.shape[1]):
        found = traction_at(s, face_point(nodes, s.shapes, q), f, q, env)
        if found.pressure > real(0.0):
            force = s.areas[f, q] * (found.pressure * found.normal + found.friction)
            for i in range(3):
                for c in range(3):
                    wp.atomic_add(force_out, s.slots[f, i], c, lane, s.multiplier_shapes[q, i] * force[c])


@large_kernel
def nearest_kernel(
    s: Surface, x: Vectors, dense: wp.array2d(dtype=wp.float64), at_rest: wp.float64, active: Envs,
    # outputs
    distance_out: Scalars, of_edge_out: Scalars,
):
    """Least distance of the shape from the surface at points with shape functions ``dense`` (point, node).

    Also the largest overlap beyond ``at_rest``, over the edge of its face.
    """
    f, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    nodes = face_positions(s, x, f, env)
    gap = gap_lower_bound(s, nodes, env)
    if gap > distance_out[env] and -(gap + at_rest) / s.edges[f] <= of_edge_out[env]:
        return
    least = real(wp.inf)
    for q in range(dense.shape[0]):
        least = wp.min(least, shape_distance(s, face_point(nodes, dense, q), env))
    wp.atomic_min(distance_out, env, least)
    wp.atomic_max(of_edge_out, env, -(least + at_rest) / s.edges[f])


@large_kernel
def room_kernel(
    s: Surface, other: Surface, x: Vectors, dense: wp.array2d(dtype=wp.float64), active: Envs,
    # outputs
    room_out: Scalars,
):
    """Least distance from another contact's shape minus the overlap, at points that overlap this shape."""
    f, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    nodes = face_positions(s, x, f, env)
    if gap_lower_bound(s, nodes, env) > real(0.0):
        return
    room = real(wp.inf)
    for q in range(dense.shape[0]):
        position = face_point(nodes, dense, q)
        gap = shape_distance(s, position, env)
        if gap < real(0.0):
            room = wp.min(room, gap + shape_distance(other, position, env))
    wp.atomic_min(room_out, env, room)
