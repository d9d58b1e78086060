"""Coarsest level of multigrid: rigid motions of aggregates, solved by a dense inverse that is rebuilt for each state.

Gel that an indenter has pressed thin is many times as stiff as at rest, and held where it touches. A coarse matrix of
the rest state makes corrections too large there, and the linear solver stalls.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
import warp as wp

from simgen.fem import batch_arrays
from simgen.fem.batch_arrays import Envs, IndexTable, Indices
from simgen.fem.blocks import TILE, Blocks, block
from simgen.fem.linear_solver import dense_inverse
from simgen.fem.linear_solver.aggregation import MOTIONS
from simgen.fem.linear_solver.pattern import BlockPattern
from simgen.fem.linear_solver.transfer import Transfer
from simgen.fem.precision import single, vec3f

wp.set_module_options({"enable_backward": False})


@wp.kernel
def galerkin_kernel(
    row_starts: Indices, neighbours: Indices, blocks: Blocks, motions: IndexTable, basis: wp.array2d(dtype=vec3f),
    m: wp.int32, active: Envs,
    # outputs
    matrices_out: dense_inverse.Matrices,
):
    """Add P^T A P; ``motions`` (corner, 6), or -1, and ``basis`` (corner, 6) are the prolongation P."""
    row, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    for k in range(row_starts[row], row_starts[row + 1]):
        A, other = block(blocks, k, env), neighbours[k]
        for b in range(motions.shape[1]):
            if motions[other, b] >= 0:
                force = A * basis[other, b]
                for a in range(motions.shape[1]):
                    if motions[row, a] >= 0:
                        entry = motions[row, a] * m + motions[other, b]
                        wp.atomic_add(matrices_out, env / TILE, entry, env % TILE, wp.dot(basis[row, a], force))


@wp.kernel
def clear_kernel(m: wp.int32, used: wp.int32, active: Envs, matrices_out: dense_inverse.Matrices):
    """Zero, except for ones on the diagonal of padding rows."""
    row, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    for column in range(m):
        matrices_out[env / TILE, row * m + column, env % TILE] = wp.where(
            row == column and row >= used, single(1.0), single(0.0)
        )


class CoarseLevel:
    """Solver for motions of aggregates in the active environments; ``space`` (3 n, m) comes from `coarse_space`."""

    def __init__(self, pattern: BlockPattern, space: sparse.csr_array, active):
        self.pattern, self.active, self.n_motions = pattern, active, space.shape[1]
        self._m, n_env, device = dense_inverse.padded(self.n_motions), active.shape[0], active.device
        self._transfer = Transfer(space, active)
        motions, basis = per_corner(space)
        self._motions = wp.array(motions, dtype=wp.int32, device=device)
        self._basis = wp.array(basis, dtype=vec3f, device=device)
        self.inverse = dense_inverse.zeros(self._m, n_env, device)
        self._invert = dense_inverse.Inverter(self.inverse, self._m, active)
        self._forces, self._x = (wp.zeros((self._m, n_env), dtype=wp.float32, device=device) for _ in range(2))

    def rebuild(self, blocks: Blocks):
        """Invert the coarse matrix of the corners' blocks."""
        m, pattern = self._m, self.pattern
        batch_arrays.launch(clear_kernel, m, [m, self.n_motions, self.active], [self.inverse])
        inputs = [pattern.row_starts, pattern.columns, blocks, self._motions, self._basis, m, self.active]
        batch_arrays.launch(galerkin_kernel, pattern.n, inputs, [self.inverse])
        self._invert()

    def correct(self, residual, x):
        """Add the coarse correction for the residual to x."""
        self._transfer.restrict(residual, self._forces)
        dense_inverse.multiply(self.inverse, self._m, self._forces, self.active, self._x)
        self._transfer.add_prolonged(self._x, x)


def per_corner(space: sparse.csr_array) -> tuple[np.ndarray, np.ndarray]:
    """Columns (n, 6) of a space (3 n, m) in which each corner has entries, then -1, and the entries (n, 6, 3)."""
    n = space.shape[0] // 3
    found = sparse.coo_array(space)
    corners, components = np.divmod(found.row, 3)
    pairs, slot_of = np.unique(corners.astype(np.int64) * space.shape[1] + found.col, return_inverse=True)
    owner, column = np.divmod(pairs, space.shape[1])
    place = np.arange(len(pairs)) - np.searchsorted(owner, owner)  # among the columns of the same corner
    motions, basis = np.full((n, MOTIONS), -1), np.zeros((n, MOTIONS, 3))
    motions[owner, place] = column
    basis[corners, place[slot_of], components] = found.data
    return motions, basis
