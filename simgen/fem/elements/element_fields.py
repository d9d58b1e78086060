"""Fields on one element in either precision: derivatives at its corners, and nodal forces.

Derivatives of a quadratic field by the element's coordinates xi are linear in xi, so their values at the four corners
determine them. With barycentric coordinates l, at corner k ::

    du/dl_k = 3 u_k        du/dl_i = 4 u_ik - u_i    (u_ik in the middle of the edge)
    du/dxi_i = du/dl_i - du/dl_0

A linear field has the same derivatives at all corners. Nodes are in VTK's order, see ``element.py``.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from simgen.fem.columns import add_vector, vector_at

wp.set_module_options({"enable_backward": False})


@wp.func
def gather(tetrahedra: wp.array2d(dtype=wp.int32), x: wp.array2d(dtype=Any), e: wp.int32, a: wp.int32, env: wp.int32):
    """Vector at an element's node a."""
    return vector_at(x, 3 * tetrahedra[e, a], env)


@wp.func
def scatter(
    tetrahedra: wp.array2d(dtype=wp.int32),
    value: Any,
    e: wp.int32,
    a: wp.int32,
    env: wp.int32,
    x: wp.array2d(dtype=Any),
):
    add_vector(x, 3 * tetrahedra[e, a], env, value)


@wp.func
def corner_gradients(tetrahedra: wp.array2d(dtype=wp.int32), x: wp.array2d(dtype=Any), e: wp.int32, env: wp.int32):
    """Derivatives by xi of the field with nodal values x at corners 0 to 3: four 3 x 3 matrices."""
    u0, u1 = gather(tetrahedra, x, e, 0, env), gather(tetrahedra, x, e, 1, env)
    u2, u3 = gather(tetrahedra, x, e, 2, env), gather(tetrahedra, x, e, 3, env)
    A = wp.matrix_from_cols(u1 - u0, u2 - u0, u3 - u0)
    B, C, D = A, A, A
    if tetrahedra.shape[1] == 10:
        three, four = u0.dtype(3.0), u0.dtype(4.0)
        u01, u12 = four * gather(tetrahedra, x, e, 4, env), four * gather(tetrahedra, x, e, 5, env)
        u20, u03 = four * gather(tetrahedra, x, e, 6, env), four * gather(tetrahedra, x, e, 7, env)
        u13, u23 = four * gather(tetrahedra, x, e, 8, env), four * gather(tetrahedra, x, e, 9, env)
        A = wp.matrix_from_cols(u01 - u1 - three * u0, u20 - u2 - three * u0, u03 - u3 - three * u0)
        B = wp.matrix_from_cols(three * u1 - u01 + u0, u12 - u2 - u01 + u0, u13 - u3 - u01 + u0)
        C = wp.matrix_from_cols(u12 - u1 - u20 + u0, three * u2 - u20 + u0, u23 - u3 - u20 + u0)
        D = wp.matrix_from_cols(u13 - u1 - u03 + u0, u23 - u2 - u03 + u0, three * u3 - u03 + u0)
    return A, B, C, D


@wp.func
def column(A: Any, j: wp.int32):
    return wp.vector(A[0, j], A[1, j], A[2, j])


@wp.func
def scatter_gradients(
    tetrahedra: wp.array2d(dtype=wp.int32),
    A: Any,
    B: Any,
    C: Any,
    D: Any,
    e: wp.int32,
    env: wp.int32,
    x: wp.array2d(dtype=Any),
):
    """Add the nodal forces of stresses at the corners: the transpose of `corner_gradients`."""
    a1, a2, a3 = column(A, 0), column(A, 1), column(A, 2)
    b1, b2, b3 = column(B, 0), column(B, 1), column(B, 2)
    c1, c2, c3 = column(C, 0), column(C, 1), column(C, 2)
    d1, d2, d3 = column(D, 0), column(D, 1), column(D, 2)
    a0, b0, c0, d0 = -(a1 + a2 + a3), -(b1 + b2 + b3), -(c1 + c2 + c3), -(d1 + d2 + d3)
    if tetrahedra.shape[1] == 10:
        three, four = a0.dtype(3.0), a0.dtype(4.0)
        scatter(tetrahedra, three * a0 - b0 - c0 - d0, e, 0, env, x)
        scatter(tetrahedra, three * b1 - a1 - c1 - d1, e, 1, env, x)
        scatter(tetrahedra, three * c2 - a2 - b2 - d2, e, 2, env, x)
        scatter(tetrahedra, three * d3 - a3 - b3 - c3, e, 3, env, x)
        scatter(tetrahedra, four * (a1 + b0), e, 4, env, x)
        scatter(tetrahedra, four * (b2 + c1), e, 5, env, x)
        scatter(tetrahedra, four * (a2 + c0), e, 6, env, x)
        scatter(tetrahedra, four * (a3 + d0), e, 7, env, x)
        scatter(tetrahedra, four * (b3 + d1), e, 8, env, x)
        scatter(tetrahedra, four * (c3 + d2), e, 9, env, x)
    else:
        scatter(tetrahedra, a0 + b0 + c0 + d0, e, 0, env, x)
        scatter(tetrahedra, a1 + b1 + c1 + d1, e, 1, env, x)
        scatter(tetrahedra, a2 + b2 + c2 + d2, e, 2, env, x)
        scatter(tetrahedra, a3 + b3 + c3 + d3, e, 3, env, x)


@wp.func
def without_mean(A: Any, B: Any, C: Any, D: Any):
    """Four matrices at the corners minus their mean."""
    mean = A.dtype(0.25) * (A + B + C + D)
    return A - mean, B - mean, C - mean, D - mean


@wp.func
def corner_pressures(
    tetrahedra: wp.array2d(dtype=wp.int32), x: wp.array2d(dtype=Any), first: wp.int32, e: wp.int32, env: wp.int32
):
    """Pressures (4,) at the corners of a quadratic element; zeros for linear elements, which have none."""
    none = type(x[0, env])(0.0)
    p = wp.vector(none, none, none, none)
    if tetrahedra.shape[1] == 10:
        for b in range(4):
            p[b] = x[first + tetrahedra[e, b], env]
    return p


@wp.func
def scatter_pressures(
    tetrahedra: wp.array2d(dtype=wp.int32), values: Any, first: wp.int32, e: wp.int32, env: wp.int32,
    x: wp.array2d(dtype=Any),
):  # fmt: skip
    if tetrahedra.shape[1] == 10:
        for b in range(4):
            wp.atomic_add(x, first + tetrahedra[e, b], env, values[b])


@wp.func
def interpolate(shapes: Any, A: Any, B: Any, C: Any, D: Any):
    """Value of a linear field from its values at the corners."""
    return shapes[0] * A + shapes[1] * B + shapes[2] * C + shapes[3] * D


@wp.func
def corner_axis(i: wp.int32) -> wp.vec3f:
    """Gradient by xi of corner i's linear shape function."""
    if i == 0:
        return wp.vec3f(-1.0, -1.0, -1.0)
    axis = wp.vec3f()
    axis[i - 1] = 1.0
    return axis


@wp.func
def edge_gradient(shapes: wp.vec4f, i: wp.int32, j: wp.int32) -> wp.vec3f:
    """Gradient by xi of the quadratic shape function of edge ij's middle, or of corner i where j = i."""
    if i == j:
        return (4.0 * shapes[i] - 1.0) * corner_axis(i)
    return 4.0 * (shapes[j] * corner_axis(i) + shapes[i] * corner_axis(j))
