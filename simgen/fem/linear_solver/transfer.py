"""Transfer between levels of multigrid: a sparse matrix, the same in all environments, and its transpose."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
import warp as wp

from simgen.fem import batch_arrays, groups
from simgen.fem.batch_arrays import Envs, Indices, SingleVectors
from simgen.fem.columns import number_at
from simgen.fem.groups import cpu_kernel, gpu_kernel, group_at
from simgen.fem.linear_solver.group_rows import group_sparse_row
from simgen.fem.precision import single

wp.set_module_options({"enable_backward": False})

PART = wp.constant(16)  # numbers of a long row that one thread of a GPU adds up
LONG_ROW = 64  # an aggregate's row has some 300 numbers


@wp.func
def sparse_row(
    row_starts: Indices, columns: Indices, values: wp.array(dtype=wp.float32), x: SingleVectors, factor: single,
    keep: wp.bool, row: wp.int32, env: wp.int32, y_out: SingleVectors,
):
    total = single(0.0)
    for k in range(row_starts[row], row_starts[row + 1]):
        total += values[k] * number_at(x, columns[k], env)
    total *= factor
    if keep:
        total += y_out[row, env]
    y_out[row, env] = total


@gpu_kernel
def sparse_kernel(
    row_starts: Indices, columns: Indices, values: wp.array(dtype=wp.float32), x: SingleVectors, factor: single,
    keep: wp.bool, active: Envs,
    # outputs
    y_out: SingleVectors,
):
    """y = factor times M x, plus y if ``keep``."""
    row, lane = wp.tid()
    env = active[lane]
    if env >= 0:
        sparse_row(row_starts, columns, values, x, factor, keep, row, env, y_out)


@gpu_kernel
def sparse_parts_kernel(
    row_starts: Indices, columns: Indices, values: wp.array(dtype=wp.float32), x: SingleVectors, factor: single,
    active: Envs,
    # outputs
    y_out: SingleVectors,
):
    """Add factor times M x to y; each thread adds a part of a row."""
    row, part, lane = wp.tid()
    env = active[lane]
    first = row_starts[row] + PART * part
    last = wp.min(first + PART, row_starts[row + 1])
    if env < 0 or first >= last:
        return
    total = single(0.0)
    for k in range(first, last):
        total += values[k] * number_at(x, columns[k], env)
    wp.atomic_add(y_out, row, env, factor * total)


@cpu_kernel
def group_sparse_kernel(
    row_starts: Indices, columns: Indices, values: wp.array(dtype=wp.float32), x: SingleVectors, factor: single,
    keep: wp.bool, active: Envs,
    # outputs
    y_out: SingleVectors,
):
    row, lane = wp.tid(), wp.int32(0)
    first, count, group = group_at(active, lane, x.shape[1])
    while count > 0:
        if group == 0:
            for k in range(lane, lane + count):
                sparse_row(row_starts, columns, values, x, factor, keep, row, active[k], y_out)
        else:
            group_sparse_row(row_starts, columns, values, x, factor, keep, row, first, group, y_out)
        lane += count
        first, count, group = group_at(active, lane, x.shape[1])


class Transfer:
    """Prolongation by a sparse matrix, and restriction by its transpose, in the active environments."""

    def __init__(self, matrix: sparse.csr_array, active):
        self.shape, self._active, device = matrix.shape, active, active.device
        transpose = sparse.csr_array(matrix.T)
        self._matrix, self._transpose = (self._on_device(m, device) for m in (matrix, transpose))
        longest = int(np.diff(transpose.indptr).max(initial=0))
        self._parts = -(-longest // PART) if longest >= LONG_ROW else 1  # of a row, one for each thread

    @staticmethod
    def _on_device(matrix, device):
        indices = [wp.array(a.astype(np.int32), dtype=wp.int32, device=device) for a in (matrix.indptr, matrix.indices)]
        return [*indices, wp.array(matrix.data, dtype=wp.float32, device=device)]

    def _launch(self, matrix, rows, x, factor, keep, out):
        inputs = [*matrix, x, factor, keep, self._active]
        groups.launch(group_sparse_kernel, sparse_kernel, rows, inputs, [out])

    def prolong(self, x, y_out):
        """y = M x."""
        self._launch(self._matrix, self.shape[0], x, 1.0, False, y_out)

    def add_prolonged(self, x, y_out):
        """y += M x."""
        self._launch(self._matrix, self.shape[0], x, 1.0, True, y_out)

    def restrict(self, x, y_out, factor: float = 1.0):
        """y = factor times M^T x."""
        if self._parts == 1 or not self._active.few:
            self._launch(self._transpose, self.shape[1], x, factor, False, y_out)
            return
        batch_arrays.clear(self._active, y_out)
        inputs = [*self._transpose, x, factor, self._active]
        batch_arrays.launch(sparse_parts_kernel, (self.shape[1], self._parts), inputs, [y_out])
