"""Kernels for the history of a contact: multipliers, stiffness factors, and the anchors from which slip counts.

The formulas are in ``traction.py``.
"""

from __future__ import annotations

import warp as wp

from simgen.fem.batch_arrays import Envs, IndexTable, Scalars, Vectors
from simgen.fem.contact.traction import (
    Surface,
    candidate_face,
    face_point,
    face_positions,
    gap_at,
    return_to_cone,
    to_shape_frame,
    traction_at,
)
from simgen.fem.device import large_kernel
from simgen.fem.precision import mat33, real, vec3
from simgen.geometry.signed_distance import distance

wp.set_module_options({"enable_backward": False})


# Largest factors on a face's stiffness: at the start of an increment, and if the increment is solved again for a deep
# overlap. With such a stiffness on all faces the surface locks: forces rise by 1 to 7 %.
MAX_STIFFENING, MAX_IN_INCREMENT = 16.0, 128.0
ALLOWED_OVERLAP = wp.constant(wp.float64(0.15))  # share of a face's edge: beyond, its stiffness grows with the overlap


@large_kernel
def stiffen_kernel(s: Surface, x: Vectors, most: wp.float64, active: Envs, stiffening_out: Vectors):
    """Stiffness factor of a face for the increment that begins at x: a power of two from 1 to ``most``.

    It is at least the face's largest multiplier over E, and at least the factor that a deep overlap needs. It is
    constant during the increment, because a stiffness that changed with the state would be one more nonlinearity.
    """
    f, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    needed = real(0.0)
    for i in range(3):
        needed = wp.max(needed, s.normal[s.slots[f, i], env])
    if needed > real(0.0):
        nodes = face_positions(s, x, f, env)
        for q in range(s.areas.shape[1]):
            overlap = -gap_at(s, face_point(nodes, s.shapes, q), f, q, env) / s.edges[f]
            if overlap > ALLOWED_OVERLAP:
                needed = wp.max(needed, s.stiffening[f, env] * overlap / ALLOWED_OVERLAP)
    factor = real(1.0)
    while factor < needed and factor < most:
        factor *= real(2.0)
    stiffening_out[f, env] = factor


@wp.func
def way_until_entry(gap_before: real, gap: real, gap_predicted: real, ratio: real):
    """Share of the way to the predicted state after which a point with a positive gap enters contact.

    Near the edge of a contact, a gap closes as (time until entry)^(3/2). The point's motion along the surface slows
    down in the same manner. So the remaining way over the last increment's way equals the gap over what that increment
    closed. It is at most the way of an entry at the predicted state. ``ratio`` is the way to that state over the last
    increment's way, or 0 if the last increment had another direction. Then the way is straight.
    """
    if ratio > real(0.0) and gap_before > gap:
        at_the_end = wp.pow(ratio, real(1.5)) / (wp.pow(real(1.0) + ratio, real(1.5)) - wp.pow(ratio, real(1.5)))
        left = wp.min(gap / (gap_before - gap), at_the_end)  # in ways of the last increment
        return wp.min(left / ratio, real(1.0))
    return gap / (gap - wp.min(gap_predicted, real(0.0)))


@large_kernel
def anchor_kernel(
    s: Surface, x_previous: Vectors, x_start: Vectors, x_predicted: Vectors, rotation_previous: wp.array(dtype=mat33),
    origin_previous: wp.array(dtype=vec3), rotation_start: wp.array(dtype=mat33), origin_start: wp.array(dtype=vec3),
    ratio: Scalars, carried: wp.array3d(dtype=vec3), in_contact: wp.array2d(dtype=wp.int32), active: Envs,
    # outputs
    anchor_out: wp.array3d(dtype=vec3),
):
    """Anchors from which slip counts, in the shape's frame.

    In contact, the anchor is the start minus the slip carried over. Otherwise it lies on the straight way to the
    predicted state, where the point enters contact, or at the end of this way; see `way_until_entry`. An indenter that
    does not touch the surface at the start approaches it at constant speed.
    """
    k, lane = wp.tid()
    env = active[lane]
    f = candidate_face(s, k, env)
    if f < 0:
        return
    shape = s.rigid[s.shape_of[env]]
    earlier = face_positions(s, x_previous, f, env)
    before = face_positions(s, x_start, f, env)
    after = face_positions(s, x_predicted, f, env)
    for q in range(s.areas.shape[1]):
        start = wp.transpose(rotation_start[env]) * (face_point(before, s.shapes, q) - origin_start[env])
        predicted = to_shape_frame(s, face_point(after, s.shapes, q), env)
        g0 = distance(shape, start) + s.gap_offset[f, q]
        slip = carried[k, q, env]
        entry = real(0.0)
        if g0 > real(0.0) and wp.length_sq(slip) == real(0.0):
            previous = face_point(earlier, s.shapes, q) - origin_previous[env]
            gap_before = distance(shape, wp.transpose(rotation_previous[env]) * previous) + s.gap_offset[f, q]
            gap_predicted = distance(shape, predicted) + s.gap_offset[f, q]
            entry = way_until_entry(gap_before, g0, gap_predicted, ratio[env] * real(in_contact[0, env]))
        anchor_out[f, q, env] = start + entry * (predicted - start) - slip


@large_kernel
def carry_kernel(
    s: Surface, x: Vectors, was_candidate: IndexTable, stiffening: Vectors, active: Envs,
    # outputs
    carried_out: wp.array3d(dtype=vec3), in_contact_out: wp.array2d(dtype=wp.int32),
):
    """Slip carried over, in the shape's frame: with it the next increment begins with the friction of this state.

    Multipliers equal the tractions only on average around a corner. Without the carried slip the difference at a point
    would be lost, and a sticking contact would creep with the number of increments.
    """
    k, lane = wp.tid()
    env = active[lane]
    f = candidate_face(s, k, env)
    if f < 0:
        return
    touched = was_candidate[f, env] == 1  # otherwise the anchor is an old one
    nodes = face_positions(s, x, f, env)
    k_inverse = s.edges[f] / (stiffening[f, env] * s.friction_stiffness)
    for q in range(s.areas.shape[1]):
        found = traction_at(s, face_point(nodes, s.shapes, q), f, q, env)
        slip = vec3()
        if touched and found.pressure > real(0.0) and found.multiplier > real(0.0):
            slip = wp.transpose(s.rotation[env]) * ((found.tangential - found.friction) * k_inverse)
            in_contact_out[0, env] = 1
        carried_out[k, q, env] = slip


@wp.func
def updated_normal(s: Surface, sums: wp.array2d(dtype=wp.vec4d), weight: real, slot: wp.int32, env: wp.int32) -> real:
    return wp.max(s.normal[slot, env] + sums[slot, env][0] / weight, real(0.0))


@wp.func
def updated_tangential(
    s: Surface, sums: wp.array2d(dtype=wp.vec4d), weight: real, normal: real, slot: wp.int32, env: wp.int32,
) -> vec3:
    found = sums[slot, env]
    return return_to_cone(
        s.tangential[slot, env] + vec3(found[1], found[2], found[3]) / weight, s.friction * normal
    )


@wp.kernel
def change_kernel(s: Surface, weights: Scalars, sums: wp.array2d(dtype=wp.vec4d), active: Envs, change_out: Vectors):
    """Sum the squared change and squared size of the multipliers in an update (lumped, area times edge)."""
    slot, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    w = weights[slot]
    normal = updated_normal(s, sums, w, slot, env)
    dn = normal - s.normal[slot, env]
    dt = updated_tangential(s, sums, w, normal, slot, env) - s.tangential[slot, env]
    wp.atomic_add(change_out, 0, env, w * (dn * dn + wp.dot(dt, dt)))
    wp.atomic_add(change_out, 1, env, w * normal * normal)


@wp.kernel
def update_kernel(s: Surface, weights: Scalars, sums: wp.array2d(dtype=wp.vec4d), active: Envs):
    """Move the multipliers."""
    slot, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    w = weights[slot]
    normal = updated_normal(s, sums, w, slot, env)
    s.tangential[slot, env] = updated_tangential(s, sums, w, normal, slot, env)
    s.normal[slot, env] = normal


@wp.kernel
def extrapolate_kernel(
    s: Surface, normal_before: Vectors, tangential_before: wp.array2d(dtype=vec3), factor: Scalars, active: Envs,
):
    """Extrapolate the multipliers with the displacements' factor, so that the forces fit the predicted state."""
    slot, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    normal, tangential, a = s.normal[slot, env], s.tangential[slot, env], factor[env]
    s.normal[slot, env] = wp.max(normal + a * (normal - normal_before[slot, env]), real(0.0))
    s.tangential[slot, env] = tangential + a * (tangential - tangential_before[slot, env])
