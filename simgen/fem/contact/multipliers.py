"""What contact remembers: multipliers, which follow the tractions, and where slip began to count.

Gathering and scattering only; the formulas are in ``traction.py``.
"""

from __future__ import annotations

import warp as wp

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
from simgen.fem.material.neo_hookean import mat33, real, vec3
from simgen.geometry.signed_distance import distance

wp.set_module_options({"enable_backward": False})


# Most that a face's stiffness is raised by: where an increment begins, and where it is solved again because the surface
# overlaps the shape too far. A surface that is held so stiffly everywhere locks: forces rise by 1 to 7 %.
MOST_STIFFENING, MOST_IN_INCREMENT = 16.0, 128.0
HELD_OVERLAP = wp.constant(wp.float64(0.15))  # of a face's edge: beyond, its stiffness grows with the overlap


@large_kernel
def stiffen_kernel(
    s: Surface,
    x: wp.array2d(dtype=wp.float64),
    most: wp.float64,
    active: wp.array(dtype=wp.int32),
    # outputs
    stiffening_out: wp.array2d(dtype=wp.float64),
):
    """The stiffness that a face needs at x, where an increment begins, as a power of two from 1 to ``most``.

    That is its largest multiplier over E, or what holds a deep overlap. It is held during the increment: a stiffness
    that followed every change would be one more nonlinearity.
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
            if overlap > HELD_OVERLAP:
                needed = wp.max(needed, s.stiffening[f, env] * overlap / HELD_OVERLAP)
    factor = real(1.0)
    while factor < needed and factor < most:
        factor *= real(2.0)
    stiffening_out[f, env] = factor


@large_kernel
def anchor_kernel(
    s: Surface,
    x_start: wp.array2d(dtype=wp.float64),
    x_predicted: wp.array2d(dtype=wp.float64),
    rotation_start: wp.array(dtype=mat33),
    origin_start: wp.array(dtype=vec3),
    carried: wp.array3d(dtype=vec3),
    active: wp.array(dtype=wp.int32),
    # outputs
    anchor_out: wp.array3d(dtype=vec3),
):
    """Where slip begins to count, in the shape's frame.

    A point in contact: behind the start by the slip that it carries. Else on the straight path to the predicted state:
    where a point that is apart by g0 and would overlap by -g1 enters, or at the path's end if it is not to enter.
    """
    k, lane = wp.tid()
    env = active[lane]
    f = candidate_face(s, k, env)
    if f < 0:
        return
    shape = s.rigid[s.shape_of[env]]
    before = face_positions(s, x_start, f, env)
    after = face_positions(s, x_predicted, f, env)
    for q in range(s.areas.shape[1]):
        start = wp.transpose(rotation_start[env]) * (face_point(before, s.shapes, q) - origin_start[env])
        predicted = to_shape_frame(s, face_point(after, s.shapes, q), env)
        g0 = distance(shape, start) + s.gap_offset[f, q]
        g1 = wp.min(distance(shape, predicted) + s.gap_offset[f, q], real(0.0))
        slip = carried[k, q, env]
        entry = real(0.0)
        if g0 > real(0.0) and wp.length_sq(slip) == real(0.0):
            entry = g0 / (g0 - g1)
        anchor_out[f, q, env] = start + entry * (predicted - start) - slip


@large_kernel
def carry_kernel(
    s: Surface,
    x: wp.array2d(dtype=wp.float64),
    was_candidate: wp.array2d(dtype=wp.int32),
    stiffening: wp.array2d(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    # outputs
    carried_out: wp.array3d(dtype=vec3),
):
    """The slip, in the shape's frame, that makes the next increment begin with the friction traction of this state.

    The multipliers meet the tractions only on average around a corner. Were slip counted anew at every increment, what
    differs at a point would be forgotten, and a contact that sticks would creep with the number of increments.
    """
    k, lane = wp.tid()
    env = active[lane]
    f = candidate_face(s, k, env)
    if f < 0:
        return
    touched = was_candidate[f, env] == 1  # else its anchor is of an earlier increment, or of another press
    nodes = face_positions(s, x, f, env)
    k_inverse = s.edges[f] / (stiffening[f, env] * s.friction_stiffness)
    for q in range(s.areas.shape[1]):
        found = traction_at(s, face_point(nodes, s.shapes, q), f, q, env)
        slip = vec3()
        if touched and found.pressure > real(0.0) and found.multiplier > real(0.0):
            slip = wp.transpose(s.rotation[env]) * ((found.tangential - found.friction) * k_inverse)
        carried_out[k, q, env] = slip


@wp.func
def moved_normal(s: Surface, sums: wp.array2d(dtype=wp.vec4d), weight: real, slot: wp.int32, env: wp.int32) -> real:
    return wp.max(s.normal[slot, env] + sums[slot, env][0] / weight, real(0.0))


@wp.func
def moved_tangential(
    s: Surface, sums: wp.array2d(dtype=wp.vec4d), weight: real, normal: real, slot: wp.int32, env: wp.int32
) -> vec3:
    found = sums[slot, env]
    return return_to_cone(
        s.tangential[slot, env] + vec3(found[1], found[2], found[3]) / weight, s.friction * normal
    )


@wp.kernel
def change_kernel(
    s: Surface,
    weights: wp.array(dtype=wp.float64),
    sums: wp.array2d(dtype=wp.vec4d),
    active: wp.array(dtype=wp.int32),
    # outputs
    change_out: wp.array2d(dtype=wp.float64),
):
    """Squared change and squared size of the multipliers in an update, summed (lumped, area times edge)."""
    slot, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    w = weights[slot]
    normal = moved_normal(s, sums, w, slot, env)
    dn = normal - s.normal[slot, env]
    dt = moved_tangential(s, sums, w, normal, slot, env) - s.tangential[slot, env]
    wp.atomic_add(change_out, 0, env, w * (dn * dn + wp.dot(dt, dt)))
    wp.atomic_add(change_out, 1, env, w * normal * normal)


@wp.kernel
def update_kernel(
    s: Surface,
    weights: wp.array(dtype=wp.float64),
    sums: wp.array2d(dtype=wp.vec4d),
    active: wp.array(dtype=wp.int32),
):
    """Move the multipliers."""
    slot, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    w = weights[slot]
    normal = moved_normal(s, sums, w, slot, env)
    s.tangential[slot, env] = moved_tangential(s, sums, w, normal, slot, env)
    s.normal[slot, env] = normal


@wp.kernel
def extrapolate_kernel(
    s: Surface,
    normal_before: wp.array2d(dtype=wp.float64),
    tangential_before: wp.array2d(dtype=vec3),
    factor: wp.array(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
):
    """Move the multipliers on along the line from those before: displacements that go on without them meet the forces
    of the last state.
    """
    slot, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    normal, tangential, a = s.normal[slot, env], s.tangential[slot, env], factor[env]
    s.normal[slot, env] = wp.max(normal + a * (normal - normal_before[slot, env]), real(0.0))
    s.tangential[slot, env] = tangential + a * (tangential - tangential_before[slot, env])
