"""Bounds of det F over whole elements, which find elements that are inverted somewhere.

The geometry map x(xi) of a deformed quadratic tetrahedron has a derivative that is linear in the barycentric
coordinates l: dx/dxi = l_0 A_0 + ... + l_3 A_3, with the matrices A_i at the corners (``element_fields.py``). Its
determinant is a cubic polynomial. Its twenty Bernstein coefficients are values of the symmetric trilinear form D with
D(A, A, A) = det A ::

    6 D(A_i, A_j, A_k) = sum over the permutations (a, b, c) of (i, j, k) of det [A_a e_1, A_b e_2, A_c e_3]

A polynomial lies in the convex hull of its coefficients, and those at the corners are its values there. So an element
is valid if all coefficients are positive, and inverted if one at a corner is not. Otherwise it is divided into eight
parts, and each part is tested in the same way, with means of the A_i at its corners. A part that is still undecided
after `LEVELS` divisions counts as inverted. So an element that counts as valid is valid everywhere (Johnen, Remacle and
Geuzaine, "Geometrical validity of curvilinear finite elements", J. Comput. Phys. 233, 2013).

At rest det dX/dxi > 0 in a valid mesh; there, det F = det dx/dxi / det dX/dxi has the sign of det dx/dxi. With positive
coefficients d of the rest element, det F is at least the smallest ratio c / d of the two elements' coefficients,
because each Bernstein polynomial is positive. The bound is sharpened by divisions where it is below `SHARP`.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from simgen.fem.elements.element import TET_EDGES
from simgen.fem.elements.element_fields import corner_gradients, interpolate
from simgen.fem.elements.solid import Solid
from simgen.fem.material.volume import cofactor
from simgen.fem.precision import mat33, real

wp.set_module_options({"enable_backward": False})

LEVELS = 3  # divisions of undecided parts; each makes the bound four times as sharp
SHARP = wp.constant(wp.float64(0.3))  # bounds of det F above it are not sharpened
CLOSE = wp.constant(wp.float64(0.02))  # a bound this close to a value that det F takes is sharp
NO_BOUND = wp.constant(wp.float64(-1.0))  # where the rest element has a coefficient that is not positive


def _parts() -> np.ndarray:
    """Barycentric corners (8, 4, 4) of a tetrahedron's eight parts: one at each corner, four around a diagonal."""
    corner = np.eye(4)
    middle = {frozenset(edge): corner[edge].mean(axis=0) for edge in TET_EDGES.tolist()}

    def at(*edge: int) -> np.ndarray:
        return middle[frozenset(edge)]

    at_corners = [[corner[i], *(at(i, j) for j in range(4) if j != i)] for i in range(4)]
    ring = [at(0, 1), at(1, 2), at(2, 3), at(3, 0)]
    inside = [[at(0, 2), at(1, 3), ring[i], ring[(i + 1) % 4]] for i in range(4)]
    return np.array(at_corners + inside)


PARTS = _parts()


@wp.func
def mixed(A: mat33, B: mat33, C: mat33):
    """D(A, B, C), by the cofactor of a sum: D(A + B, A + B, C) = D(A, A, C) + 2 D(A, B, C) + D(B, B, C)."""
    cofactors = cofactor(A + B) - cofactor(A) - cofactor(B)
    return wp.ddot(cofactors, C) / real(6.0)


@wp.func
def least_coefficient(A: mat33, B: mat33, C: mat33, D: mat33):
    """Least coefficient that is not at a corner."""
    cofactors_a, cofactors_b, cofactors_c, cofactors_d = cofactor(A), cofactor(B), cofactor(C), cofactor(D)
    least = wp.min(wp.ddot(cofactors_a, B), wp.min(wp.ddot(cofactors_a, C), wp.ddot(cofactors_a, D)))
    least = wp.min(least, wp.min(wp.ddot(cofactors_b, A), wp.min(wp.ddot(cofactors_b, C), wp.ddot(cofactors_b, D))))
    least = wp.min(least, wp.min(wp.ddot(cofactors_c, A), wp.min(wp.ddot(cofactors_c, B), wp.ddot(cofactors_c, D))))
    least = wp.min(least, wp.min(wp.ddot(cofactors_d, A), wp.min(wp.ddot(cofactors_d, B), wp.ddot(cofactors_d, C))))
    on_faces = wp.min(wp.min(mixed(A, B, C), mixed(A, B, D)), wp.min(mixed(A, C, D), mixed(B, C, D)))
    return wp.min(least / real(3.0), on_faces)


@wp.func
def least_at_corners(A: mat33, B: mat33, C: mat33, D: mat33):
    return wp.min(wp.min(wp.determinant(A), wp.determinant(B)), wp.min(wp.determinant(C), wp.determinant(D)))


@wp.func
def is_inside_out(A: mat33, B: mat33, C: mat33, D: mat33, parts: wp.array(dtype=wp.mat44d), levels: wp.int32):
    """Test an element with dx/dxi = A, B, C, D at its corners. Octal digits of ``number`` name the current part."""
    level, number = wp.int32(0), wp.int32(0)
    while level >= 0:
        corners = wp.identity(n=4, dtype=wp.float64)
        for i in range(level):
            corners = parts[(number >> (3 * (level - 1 - i))) & 7] * corners
        a, b = interpolate(corners[0], A, B, C, D), interpolate(corners[1], A, B, C, D)
        c, d = interpolate(corners[2], A, B, C, D), interpolate(corners[3], A, B, C, D)
        if not (least_at_corners(a, b, c, d) > real(0.0)):  # or not a number
            return True
        if least_coefficient(a, b, c, d) > real(0.0):
            while level > 0 and (number & 7) == 7:  # the last part: the level above is valid
                number = number >> 3
                level -= 1
            if level == 0:
                return False
            number += 1
        elif level == levels:
            return True
        else:
            number = number << 3
            level += 1
    return False


@wp.func
def ratio(c: real, d: real):
    return wp.where(d > real(0.0), c / d, NO_BOUND)


@wp.func
def towards(A: mat33, B: mat33, R: mat33, S: mat33):
    """Smaller ratio of the two coefficients on an edge, deformed (A, B) over rest (R, S)."""
    at_a = ratio(wp.ddot(cofactor(A), B), wp.ddot(cofactor(R), S))
    return wp.min(at_a, ratio(wp.ddot(cofactor(B), A), wp.ddot(cofactor(S), R)))


@wp.func
def least_ratio_at_corners(
    A: mat33, B: mat33, C: mat33, D: mat33, R: mat33, S: mat33, T: mat33, U: mat33
):
    """Least det F at the corners, deformed (A, B, C, D) over rest (R, S, T, U)."""
    ab = wp.min(ratio(wp.determinant(A), wp.determinant(R)), ratio(wp.determinant(B), wp.determinant(S)))
    return wp.min(
        ab, wp.min(ratio(wp.determinant(C), wp.determinant(T)), ratio(wp.determinant(D), wp.determinant(U)))
    )


@wp.func
def least_ratio(A: mat33, B: mat33, C: mat33, D: mat33, R: mat33, S: mat33, T: mat33, U: mat33):
    """Least ratio of the coefficients that are not at a corner, deformed (A, B, C, D) over rest (R, S, T, U)."""
    least = wp.min(towards(A, B, R, S), wp.min(towards(A, C, R, T), towards(A, D, R, U)))
    least = wp.min(least, wp.min(towards(B, C, S, T), wp.min(towards(B, D, S, U), towards(C, D, T, U))))
    abc, abd = ratio(mixed(A, B, C), mixed(R, S, T)), ratio(mixed(A, B, D), mixed(R, S, U))
    acd, bcd = ratio(mixed(A, C, D), mixed(R, T, U)), ratio(mixed(B, C, D), mixed(S, T, U))
    return wp.min(least, wp.min(wp.min(abc, abd), wp.min(acd, bcd)))


@wp.func
def bound_of_det_F(
    A: mat33, B: mat33, C: mat33, D: mat33, R: mat33, S: mat33, T: mat33, U: mat33,
    parts: wp.array(dtype=wp.mat44d), levels: wp.int32,
):
    """Lower bound of det F in an element with dx/dxi = A, B, C, D and dX/dxi = R, S, T, U at its corners.

    It is not positive exactly where `is_inside_out` is True. Octal digits of ``number`` name the current part.
    """
    bound = wp.min(least_ratio_at_corners(A, B, C, D, R, S, T, U), least_ratio(A, B, C, D, R, S, T, U))
    if bound > SHARP:
        return bound
    whole, bound = bound, real(wp.inf)
    level, number = wp.int32(0), wp.int32(0)
    while level >= 0:
        corners = wp.identity(n=4, dtype=wp.float64)
        for i in range(level):
            corners = parts[(number >> (3 * (level - 1 - i))) & 7] * corners
        a, b = interpolate(corners[0], A, B, C, D), interpolate(corners[1], A, B, C, D)
        c, d = interpolate(corners[2], A, B, C, D), interpolate(corners[3], A, B, C, D)
        r, s = interpolate(corners[0], R, S, T, U), interpolate(corners[1], R, S, T, U)
        t, u = interpolate(corners[2], R, S, T, U), interpolate(corners[3], R, S, T, U)
        value = least_ratio_at_corners(a, b, c, d, r, s, t, u)
        if not (value > real(0.0)):  # or not a number
            return whole
        lower = wp.min(value, least_ratio(a, b, c, d, r, s, t, u))
        if lower > SHARP or (lower > value - CLOSE and lower > real(0.0)) or level == levels:
            bound = wp.min(bound, lower)
            if not (bound > real(0.0)):
                return wp.min(whole, bound)
            while level > 0 and (number & 7) == 7:  # the last part: the level above is done
                number = number >> 3
                level -= 1
            if level == 0:
                return bound
            number += 1
        else:
            number = number << 3
            level += 1
    return bound


@wp.func
def deformed_corners(s: Solid, x: wp.array2d(dtype=wp.float64), e: wp.int32, env: wp.int32):
    """Derivatives dx/dxi at an element's corners in state x: four 3 x 3 matrices, mm."""
    ua, ub, uc, ud = corner_gradients(s.tetrahedra, x, e, env)
    return s.rest[e, 0] + ua, s.rest[e, 1] + ub, s.rest[e, 2] + uc, s.rest[e, 3] + ud


@wp.kernel
def det_F_kernel(
    s: Solid,
    x: wp.array2d(dtype=wp.float64),
    parts: wp.array(dtype=wp.mat44d),
    levels: wp.int32,
    active: wp.array(dtype=wp.int32),
    # outputs
    count_out: wp.array(dtype=wp.int32),
    least_out: wp.array(dtype=wp.float64),
):
    """Count the elements that are inverted somewhere, and lower ``least_out`` (env,) to the bound of det F."""
    e, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    A, B, C, D = deformed_corners(s, x, e, env)
    bound = bound_of_det_F(A, B, C, D, s.rest[e, 0], s.rest[e, 1], s.rest[e, 2], s.rest[e, 3], parts, levels)
    if not (bound > real(0.0)):
        wp.atomic_add(count_out, env, 1)
    wp.atomic_min(least_out, env, bound)
