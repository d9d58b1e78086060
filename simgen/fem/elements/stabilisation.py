"""Stabilisation of single elements that are about to invert.

Under an edge the free surface is compressed so far that a neo-Hookean solid folds into itself, at any length that the
mesh allows (Biot's instability; Hohlfeld and Mahadevan, Phys. Rev. Lett. 106, 2011). Quadratic elements then invert
between their integration points, and a finer mesh has more such elements. Two energies keep an element from inverting.
Both grow with its weight w::

    w mu / 32  mean over the corners of |grad u - its mean|^2     (strain gradient; its length is the element's)
    min(w mu, lam / 4) / 2  (J - 1)^2                             (volume, pointwise)

The first is quadratic in u. It is zero for rotations and for uniform strains of any size, and vanishes as h^2 for
smooth fields. The second raises the bulk stiffness by at most a quarter, so that compressible solids stay compressible.
Weights start at zero and never fall during a press. They make the body stiffer, so they are small. An element that is
nearly flat gets a weight where an increment starts or is expected to end. If it is inverted where the increment has
converged, its weight is doubled, and the increment is solved again (see ``load_stepping``). This repeat and the next
increment are checked before they converge, too. If an element is inverted where an increment is damped for the first
time, its weight is doubled as well.
"""

from __future__ import annotations

import warp as wp

from simgen.fem.elements.solid import Solid
from simgen.fem.elements.validity import deformed_corners, is_inside_out, least_at_corners, least_coefficient
from simgen.fem.precision import real, single

wp.set_module_options({"enable_backward": False})

FIRST, MOST = wp.constant(wp.float32(1.0)), wp.constant(wp.float32(1024.0))  # weights
MOST_EXTRA_OF_LAM = 0.25
FLAT = wp.constant(wp.float64(0.1))  # an element whose lower bound of det F is less gets a weight


@wp.kernel
def expect_kernel(
    s: Solid,
    x: wp.array2d(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    # outputs
    weight_out: wp.array2d(dtype=wp.float32),
):
    """Give elements that are nearly flat at x at least `FIRST`: twice that below half of `FLAT`, four times below 0."""
    e, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    A, B, C, D = deformed_corners(s, x, e, env)
    rest = least_at_corners(s.rest[e, 0], s.rest[e, 1], s.rest[e, 2], s.rest[e, 3])
    least = wp.min(least_at_corners(A, B, C, D), least_coefficient(A, B, C, D)) / rest
    if least < FLAT:
        first = FIRST
        if least < real(0.5) * FLAT:
            first *= single(2.0)
        if least < real(0.0):
            first *= single(2.0)
        weight_out[e, env] = wp.max(weight_out[e, env], first)


@wp.kernel
def raise_kernel(
    s: Solid,
    x: wp.array2d(dtype=wp.float64),
    parts: wp.array(dtype=wp.mat44d),
    levels: wp.int32,
    active: wp.array(dtype=wp.int32),
    # outputs
    weight_out: wp.array2d(dtype=wp.float32),
    raised_out: wp.array(dtype=wp.int32),
):
    """Double the weights of elements that are inside out at x; count those whose weight could be raised."""
    e, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    A, B, C, D = deformed_corners(s, x, e, env)
    if weight_out[e, env] < MOST and is_inside_out(A, B, C, D, parts, levels):
        weight_out[e, env] = wp.max(single(2.0) * weight_out[e, env], FIRST)
        wp.atomic_add(raised_out, env, 1)


@wp.kernel
def reinforce_kernel(
    marked: wp.array(dtype=wp.int32),
    # outputs
    weight_out: wp.array2d(dtype=wp.float32),
):
    e, lane = wp.tid()
    env = marked[lane]
    if env >= 0:
        weight_out[e, env] = wp.min(single(4.0) * weight_out[e, env], MOST)


@wp.kernel
def count_kernel(
    weight: wp.array2d(dtype=wp.float32),
    active: wp.array(dtype=wp.int32),
    # outputs
    count_out: wp.array(dtype=wp.int32),
):
    """Count the elements that have a weight."""
    e, lane = wp.tid()
    env = active[lane]
    if env >= 0 and weight[e, env] > single(0.0):
        wp.atomic_add(count_out, env, 1)
