"""Inverses of dense matrices, one for each environment, in place: Gauss-Jordan elimination by blocks of 4 x 4.

Matrices lie in tiles of environments, as blocks do (see ``blocks``): entry (r, c) of a matrix of m rows is row r m + c
of a tile. Pivots are not searched for: the matrices are stiffnesses, positive definite or nearly so. Single precision
is enough for a preconditioner.
"""

from __future__ import annotations

import warp as wp

from .blocks import TILE
from .material import single

wp.set_module_options({"enable_backward": False})

SIDE = 4  # of a block
STRIP = 8  # rows that one thread multiplies
Matrices = wp.array3d(dtype=wp.float32)

strip_of_rows = wp.types.vector(length=STRIP, dtype=wp.float32)


@wp.func
def load_block(matrices: Matrices, m: wp.int32, i: wp.int32, j: wp.int32, env: wp.int32) -> wp.mat44f:
    out = wp.mat44f()
    for r in range(4):
        for c in range(4):
            out[r, c] = matrices[env / TILE, (4 * i + r) * m + 4 * j + c, env % TILE]
    return out


@wp.func
def store_block(matrices: Matrices, m: wp.int32, i: wp.int32, j: wp.int32, env: wp.int32, value: wp.mat44f):
    for r in range(4):
        for c in range(4):
            matrices[env / TILE, (4 * i + r) * m + 4 * j + c, env % TILE] = value[r, c]


@wp.kernel
def row_kernel(
    m: wp.int32,
    k: wp.int32,
    active: wp.array(dtype=wp.int32),
    # outputs
    matrices_out: Matrices,
):
    """Multiply block row k by the inverse of its pivot, which stays for now."""
    j, lane = wp.tid()
    env = active[lane]
    if env < 0 or j == k:
        return
    pivot = wp.inverse(load_block(matrices_out, m, k, k, env))
    store_block(matrices_out, m, k, j, env, pivot * load_block(matrices_out, m, k, j, env))


@wp.kernel
def eliminate_kernel(
    m: wp.int32,
    k: wp.int32,
    active: wp.array(dtype=wp.int32),
    # outputs
    matrices_out: Matrices,
):
    """Take block row k from all others."""
    i, j, lane = wp.tid()
    env = active[lane]
    if env < 0 or i == k or j == k:
        return
    change = load_block(matrices_out, m, i, k, env) * load_block(matrices_out, m, k, j, env)
    store_block(matrices_out, m, i, j, env, load_block(matrices_out, m, i, j, env) - change)


@wp.kernel
def column_kernel(
    m: wp.int32,
    k: wp.int32,
    active: wp.array(dtype=wp.int32),
    # outputs
    matrices_out: Matrices,
):
    """What the elimination does to block column k of the identity."""
    i, lane = wp.tid()
    env = active[lane]
    if env < 0 or i == k:
        return
    pivot = wp.inverse(load_block(matrices_out, m, k, k, env))
    store_block(matrices_out, m, i, k, env, single(-1.0) * load_block(matrices_out, m, i, k, env) * pivot)


@wp.kernel
def pivot_kernel(
    m: wp.int32,
    k: wp.int32,
    active: wp.array(dtype=wp.int32),
    # outputs
    matrices_out: Matrices,
):
    lane = wp.tid()
    env = active[lane]
    if env >= 0:
        store_block(matrices_out, m, k, k, env, wp.inverse(load_block(matrices_out, m, k, k, env)))


@wp.kernel
def multiply_kernel(
    matrices: Matrices,
    m: wp.int32,
    x: wp.array2d(dtype=wp.float32),
    active: wp.array(dtype=wp.int32),
    # outputs
    y_out: wp.array2d(dtype=wp.float32),
):
    """Some rows of a symmetric matrix, read as columns, times x: what is read of x serves all of them."""
    strip, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    sums = strip_of_rows()
    for k in range(m):
        value = x[k, env]
        for r in range(STRIP):
            sums[r] += matrices[env / TILE, k * m + strip * STRIP + r, env % TILE] * value
    for r in range(STRIP):
        y_out[strip * STRIP + r, env] = sums[r]


def padded(rows: int) -> int:
    """Rows of the matrices that hold so many, in whole strips."""
    return -(-rows // STRIP) * STRIP


def zeros(m: int, n_env: int, device) -> wp.array:
    """Matrices (tile, m m, place in the tile) of m rows, see :func:`padded`."""
    return wp.zeros((-(-n_env // TILE), m * m, min(n_env, TILE)), dtype=wp.float32, device=device)


def invert(matrices: wp.array, m: int, active):
    """Replace the matrices of the active environments by their inverses."""
    n, lanes, device = m // SIDE, len(active), matrices.device
    for k in range(n):
        inputs = [m, k, active]
        wp.launch(row_kernel, dim=(n, lanes), inputs=inputs, outputs=[matrices], device=device)
        wp.launch(eliminate_kernel, dim=(n, n, lanes), inputs=inputs, outputs=[matrices], device=device)
        wp.launch(column_kernel, dim=(n, lanes), inputs=inputs, outputs=[matrices], device=device)
        wp.launch(pivot_kernel, dim=lanes, inputs=inputs, outputs=[matrices], device=device)


def multiply(matrices: wp.array, m: int, x, active, y_out):
    """y = M x (m, env), of symmetric matrices, in the active environments."""
    inputs = [matrices, m, x, active]
    wp.launch(multiply_kernel, dim=(m // STRIP, len(active)), inputs=inputs, outputs=[y_out], device=matrices.device)
