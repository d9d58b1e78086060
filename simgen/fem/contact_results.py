"""What is measured of a contact: gaps, forces and moments, overlap.

Gathering and scattering only; the formulas are in ``traction.py``.
"""

from __future__ import annotations

import warp as wp

from ..distance import probe
from .material import real, vec3
from .traction import Surface, deformed, probe_in_sensor_frame, surface_point, traction

wp.set_module_options({"enable_backward": False})


@wp.kernel
def gap_kernel(
    s: Surface,
    x: wp.array2d(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    # outputs
    gap_out: wp.array3d(dtype=wp.float64),
):
    f, q, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    gap_out[f, q, env] = probe_in_sensor_frame(s, deformed(s, x, f, q, env), f, q, env).distance


@wp.kernel
def resultant_kernel(
    s: Surface,
    x: wp.array2d(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    # outputs
    force_out: wp.array(dtype=vec3),
    moment_out: wp.array(dtype=vec3),
    penetration_out: wp.array2d(dtype=wp.float64),
):
    """Force and moment on the sensor; rows of ``penetration_out``: area in contact, integral of g^2 there, max -g."""
    f, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    for q in range(s.areas.shape[1]):
        found = traction(s, x, f, q, env)
        if found.pressure > real(0.0):
            area = s.areas[f, q]
            force = area * (found.pressure * found.normal + found.friction)
            wp.atomic_add(force_out, env, force)
            wp.atomic_add(moment_out, env, wp.cross(found.position, force))
            wp.atomic_add(penetration_out, 0, env, area)
            wp.atomic_add(penetration_out, 1, env, area * found.gap * found.gap)
            wp.atomic_max(penetration_out, 2, env, -found.gap)


@wp.kernel
def nearest_kernel(
    s: Surface,
    x: wp.array2d(dtype=wp.float64),
    dense: wp.array2d(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    # outputs
    distance_out: wp.array(dtype=wp.float64),
):
    """Least distance of the shape from the surface at points with shape functions ``dense`` (point, nodes)."""
    f, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    least = real(wp.inf)
    for q in range(dense.shape[0]):
        position = surface_point(s, x, dense, f, q, env)
        local = wp.transpose(s.rotation[env]) * (position - s.origin[env])
        least = wp.min(least, probe(s.rigid[s.shape_of[env]], local).distance)
    wp.atomic_min(distance_out, env, least)
