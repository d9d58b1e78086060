"""Inverses of dense matrices, one for each environment, in place: Gauss-Jordan elimination by blocks of 4 x 4.

Sixteen rows, a panel, are eliminated at once. A matrix of 192 rows does not fit into the caches of a GPU; by panels it
is read and written 12 times instead of 48. Matrices lie in tiles of environments, as blocks do (see ``blocks``): entry
(r, c) of a matrix of m rows is row r m + c of a tile. There is no pivoting: the matrices are stiffnesses, positive
definite or nearly so. Single precision is enough for a preconditioner.
"""

from __future__ import annotations

import warp as wp

from simgen.fem import batch_arrays
from simgen.fem.batch_arrays import Envs, SingleVectors
from simgen.fem.blocks import TILE
from simgen.fem.device import once, recording
from simgen.fem.precision import single

wp.set_module_options({"enable_backward": False})

SIDE = wp.constant(4)  # rows of a block
WIDE = wp.constant(4)  # block rows of a panel
STRIP, UNROLLED = 8, wp.constant(4)  # rows that one thread multiplies, and columns that it loads at once
PART, SMALL_PART = 64, 8  # columns of a thread; fewer if few environments leave a GPU idle
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
    m: wp.int32, first: wp.int32, k: wp.int32, active: Envs,
    # outputs
    matrices_out: Matrices, column_out: wp.array3d(dtype=wp.float32),
):
    """Copy block column k of the panel's diagonal square, with its pivot inverted, and scale block row k."""
    place, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    j = first + place
    pivot = wp.inverse(load_block(matrices_out, m, k, k, env))
    if j == k:
        store_block(column_out, SIDE * WIDE, place, 0, env, pivot)
    else:
        store_block(column_out, SIDE * WIDE, place, 0, env, load_block(matrices_out, m, j, k, env))
        store_block(matrices_out, m, k, j, env, pivot * load_block(matrices_out, m, k, j, env))


@wp.kernel
def eliminate_kernel(
    column: wp.array3d(dtype=wp.float32), m: wp.int32, first: wp.int32, k: wp.int32, active: Envs,
    # outputs
    matrices_out: Matrices,
):
    """Subtract multiples of block row k from the square's other rows; do the same to the identity in block column k."""
    row, place, lane = wp.tid()
    i, j = first + row, first + place
    env = active[lane]
    if env < 0 or (i == k and j != k):
        return
    own = load_block(column, SIDE * WIDE, row, 0, env)
    if j == k:
        if i != k:
            own = single(-1.0) * own * load_block(column, SIDE * WIDE, k - first, 0, env)
        store_block(matrices_out, m, i, k, env, own)
    else:
        change = own * load_block(matrices_out, m, k, j, env)
        store_block(matrices_out, m, i, j, env, load_block(matrices_out, m, i, j, env) - change)


@wp.kernel
def panels_kernel(
    matrices: Matrices, m: wp.int32, first: wp.int32, active: Envs,
    # outputs
    column_out: wp.array3d(dtype=wp.float32), rows_out: wp.array3d(dtype=wp.float32),
):
    """Copy the panel's block columns, and its block rows times the inverse of its square, which is in its place."""
    j, p, lane = wp.tid()
    env = active[lane]
    if env < 0 or (j >= first and j < first + WIDE):
        return
    store_block(column_out, SIDE * WIDE, j, p, env, load_block(matrices, m, j, first + p, env))
    scaled = wp.mat44f()
    for q in range(WIDE):
        scaled += load_block(matrices, m, first + p, first + q, env) * load_block(matrices, m, first + q, j, env)
    store_block(rows_out, m, p, j, env, scaled)


@wp.kernel
def update_kernel(
    column: wp.array3d(dtype=wp.float32), rows: wp.array3d(dtype=wp.float32), m: wp.int32, first: wp.int32,
    active: Envs,
    # outputs
    matrices_out: Matrices,
):
    """Subtract multiples of the panel's rows from all others; do the same to the identity in the panel's columns."""
    i, j, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    in_rows, in_columns = i >= first and i < first + WIDE, j >= first and j < first + WIDE
    if in_rows:
        if not in_columns:
            store_block(matrices_out, m, i, j, env, load_block(rows, m, i - first, j, env))
        return
    change = wp.mat44f()
    if in_columns:
        for q in range(WIDE):
            own = load_block(column, SIDE * WIDE, i, q, env)
            change += own * load_block(matrices_out, m, first + q, j, env)
    else:
        change -= load_block(matrices_out, m, i, j, env)
        for q in range(WIDE):
            change += load_block(column, SIDE * WIDE, i, q, env) * load_block(rows, m, q, j, env)
    store_block(matrices_out, m, i, j, env, single(-1.0) * change)


@wp.kernel
def multiply_kernel(
    matrices: Matrices, m: wp.int32, columns: wp.int32, x: SingleVectors, active: Envs, y_out: SingleVectors
):
    """Add a part of the columns of a strip of rows times x. The matrix is symmetric: rows are read as columns."""
    strip, part, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    sums = strip_of_rows()
    for first in range(part * columns, wp.min((part + 1) * columns, m), UNROLLED):
        for i in range(UNROLLED):
            k = first + i
            value = x[k, env]
            for r in range(STRIP):
                sums[r] += matrices[env / TILE, k * m + strip * STRIP + r, env % TILE] * value
    for r in range(STRIP):
        wp.atomic_add(y_out, strip * STRIP + r, env, sums[r])


def padded(rows: int) -> int:
    """Number of rows rounded up to whole panels."""
    return -(-rows // (SIDE * WIDE)) * SIDE * WIDE


def zeros(m: int, n_env: int, device) -> wp.array:
    """Matrices (tile, m m, place in the tile) of m rows, a number from :func:`padded`."""
    return wp.zeros((-(-n_env // TILE), m * m, min(n_env, TILE)), dtype=wp.float32, device=device)


class Inverter:
    """Inverts matrices (see :func:`zeros`) in place in the active environments, on a GPU as one graph."""

    def __init__(self, matrices: wp.array, m: int, active):
        self._matrices, self._m, self._active, self._graphs = matrices, m, active, {}
        tiles, _, places = matrices.shape
        self._column, self._rows = (
            wp.zeros((tiles, SIDE * WIDE * m, places), dtype=wp.float32, device=matrices.device) for _ in range(2)
        )

    def __call__(self):
        lanes = self._active.lanes
        if lanes in self._graphs:
            wp.capture_launch(self._graphs[lanes])
            return
        if wp.get_device(self._matrices.device).is_cpu:
            self._invert()
            return
        with once():
            self._invert()  # also loads the kernels, which a capture cannot do
        with recording(self._matrices.device) as recorded:
            self._invert()
        self._graphs[lanes] = recorded.graph

    def _invert(self):
        m, n, active, column, rows = self._m, self._m // SIDE, self._active, self._column, self._rows
        for first in range(0, n, WIDE):
            for k in range(first, first + WIDE):
                batch_arrays.launch(scale_kernel, WIDE, [m, first, k, active], [self._matrices, column])
                batch_arrays.launch(eliminate_kernel, (WIDE, WIDE), [column, m, first, k, active], [self._matrices])
            batch_arrays.launch(panels_kernel, (n, WIDE), [self._matrices, m, first, active], [column, rows])
            batch_arrays.launch(update_kernel, (n, n), [column, rows, m, first, active], [self._matrices])


def multiply(matrices: wp.array, m: int, x, active, y_out):
    """y = M x (m, env) with symmetric matrices, in the active environments."""
    batch_arrays.clear(active, y_out)
    columns = SMALL_PART if active.few else PART
    inputs = [matrices, m, columns, x, active]
    batch_arrays.launch(multiply_kernel, (m // STRIP, -(-m // columns)), inputs, [y_out])
