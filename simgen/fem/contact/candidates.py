"""Candidates: the faces that can touch the rigid shape in an increment. Kernels skip all others in the increment.

A face is a candidate if the distance of one of its quadrature points from the shape, at the predicted state, is less
than the indenter's travel in the increment plus one edge, or if a multiplier at one of its corners is positive. No
point of a body moves further than the indenter that presses it; beside an indenter a surface rises by less.
"""

from __future__ import annotations

import warp as wp

from simgen.fem.batch_arrays import Envs, IndexTable, Indices, Scalars, Vectors
from simgen.fem.contact.traction import Surface, face_point, face_positions, gap_at, gap_lower_bound
from simgen.fem.precision import real

wp.set_module_options({"enable_backward": False})


@wp.kernel
def no_candidates_kernel(active: Envs, count_out: Indices):
    env = active[wp.tid()]
    if env >= 0:
        count_out[env] = 0


@wp.kernel
def find_candidates_kernel(
    s: Surface, x: Vectors, travel: Scalars, active: Envs,
    # outputs
    count_out: Indices, candidates_out: IndexTable, is_candidate_out: IndexTable,
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

