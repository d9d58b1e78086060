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
def scale_kernel(
    m: wp.int32,
    k: wp.int32,
    active: wp.array(dtype=wp.int32),
    # outputs
    matrices_out: Matrices,
    column_out: wp.array3d(dtype=wp.float32),
):
    """Set block column k aside, its pivot inverted, and multiply block row k by that inverse."""
    j, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    pivot = wp.inverse(load_block(matrices_out, m, k, k, env))
    if j == k:
        store_block(column_out, 4, k, 0, env, pivot)
    else:
        store_block(column_out, 4, j, 0, env, load_block(matrices_out, m, j, k, env))
        store_block(matrices_out, m, k, j, env, pivot * load_block(matrices_out, m, k, j, env))


@wp.kernel
def eliminate_kernel(
    column: wp.array3d(dtype=wp.float32),
    m: wp.int32,
    k: wp.int32,
    active: wp.array(dtype=wp.int32),
    # outputs
    matrices_out: Matrices,
):
    """Take block row k from all others; block column k becomes what that does to the identity."""
    i, j, lane = wp.tid()
    env = active[lane]
    if env < 0 or (i == k and j != k):
        return
    own = load_block(column, 4, i, 0, env)
    if j == k:
        if i != k:
            own = single(-1.0) * own * load_block(column, 4, k, 0, env)
        store_block(matrices_out, m, i, k, env, own)
    else:
        change = own * load_block(matrices_out, m, k, j, env)
        store_block(matrices_out, m, i, j, env, load_block(matrices_out, m, i, j, env) - change)


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


class Inverter:
    """Inverts matrices (see :func:`zeros`) in place, in the ``active`` environments. On a GPU it is one graph."""

    def __init__(self, matrices: wp.array, m: int, active):
        self._matrices, self._m, self._active, self._graphs = matrices, m, active, {}
        tiles, _, places = matrices.shape
        self._column = wp.zeros((tiles, SIDE * m, places), dtype=wp.float32, device=matrices.device)

    def __call__(self):
        lanes = int((self._active.numpy() >= 0).sum())
        lanes = min(-(-lanes // TILE) * TILE, len(self._active))
        if lanes in self._graphs:
            wp.capture_launch(self._graphs[lanes])
            return
        self._invert(lanes)  # and loads the kernels, which cannot be done while one captures
        if not wp.get_device(self._matrices.device).is_cpu:
            with wp.ScopedCapture(device=self._matrices.device) as captured:
                self._invert(lanes)
            self._graphs[lanes] = captured.graph

    def _invert(self, lanes: int):
        m, n, device = self._m, self._m // SIDE, self._matrices.device
        for k in range(n):
            outputs = [self._matrices, self._column]
            wp.launch(scale_kernel, dim=(n, lanes), inputs=[m, k, self._active], outputs=outputs, device=device)
            inputs = [self._column, m, k, self._active]
            wp.launch(eliminate_kernel, dim=(n, n, lanes), inputs=inputs, outputs=[self._matrices], device=device)


def multiply(matrices: wp.array, m: int, x, active, y_out):
    """y = M x (m, env), of symmetric matrices, in the active environments."""
    inputs = [matrices, m, x, active]
    wp.launch(multiply_kernel, dim=(m // STRIP, len(active)), inputs=inputs, outputs=[y_out], device=matrices.device)
