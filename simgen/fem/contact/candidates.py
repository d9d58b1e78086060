"""Which faces can touch the rigid shape in an increment: the others need not be looked at until it has ended.

A face is a candidate if one of its quadrature points is nearer to the shape, at the predicted state, than the indenter
moves in the increment plus one edge, or if a multiplier at one of its corners presses. No point of a body moves further
than the indenter that presses it; beside an indenter a surface rises by less.
"""

from __future__ import annotations

import warp as wp

from simgen.fem.contact.traction import Surface, face_point, face_positions, gap_at, gap_lower_bound
from simgen.fem.material.neo_hookean import real

wp.set_module_options({"enable_backward": False})


@wp.kernel
def no_candidates_kernel(
    active: wp.array(dtype=wp.int32),
    # outputs
    count_out: wp.array(dtype=wp.int32),
):
    env = active[wp.tid()]
    if env >= 0:
        count_out[env] = 0


@wp.kernel
def find_candidates_kernel(
    s: Surface,
    x: wp.array2d(dtype=wp.float64),
    travel: wp.array(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    # outputs
    count_out: wp.array(dtype=wp.int32),
    candidates_out: wp.array2d(dtype=wp.int32),
    is_candidate_out: wp.array2d(dtype=wp.int32),
):
    f, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    near = False
    for i in range(3):
        if s.normal[s.slots[f, i], env] > real(0.0):
            near = True
    reach = travel[env] + s.edges[f]
    nodes = face_positions(s, x, f, env)
    if not near and gap_lower_bound(s, nodes, env) < reach:
        for q in range(s.areas.shape[1]):
            if not near:
                near = gap_at(s, face_point(nodes, s.shapes, q), f, q, env) < reach
    is_candidate_out[f, env] = int(near)
    if near:
        k = wp.atomic_add(count_out, env, 1)
        candidates_out[k, env] = f

