"""Sparsity pattern of the tangent's 3 x 3 blocks between nodes, or between corners alone for linear displacements."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
import warp as wp

from simgen.fem.elements.element import TET_EDGES


class BlockPattern:
    """Sparsity pattern of blocks, and the blocks to which the matrices of elements and faces add.

    tetrahedra (e, k) and faces, one (f, m) for each surface term: nodes below ``n``. Block i lies in the row r with
    ``row_starts[r] <= i < row_starts[r + 1]`` and in ``columns[i]``.
    """

    def __init__(self, n: int, tetrahedra: np.ndarray, faces: list[np.ndarray], device):
        nodes = tetrahedra.astype(np.int64)
        pairs = nodes[:, :, None] * n + nodes[:, None, :]
        unique, inverse = np.unique(pairs, return_inverse=True)
        rows, self.host_columns = np.divmod(unique, n)
        self.host_row_starts = np.searchsorted(rows, np.arange(n + 1))
        self.n, self.n_blocks = n, len(unique)

        def on_device(array):
            return wp.array(np.ascontiguousarray(array, dtype=np.int32), dtype=wp.int32, device=device)

        self.row_starts, self.columns = on_device(self.host_row_starts), on_device(self.host_columns)
        self.tet_index = on_device(inverse.reshape(pairs.shape))
        self.face_index = []
        for f in faces:
            f = f.astype(np.int64)
            self.face_index.append(on_device(np.searchsorted(unique, f[:, :, None] * n + f[:, None, :])))

    def graph(self) -> sparse.csr_array:
        """Graph (n, n) of the nodes: an edge for each block."""
        ones = np.ones(self.n_blocks)
        return sparse.csr_array((ones, self.host_columns, self.host_row_starts), shape=(self.n, self.n))

    def matrix(self, blocks: np.ndarray) -> sparse.csr_array:
        """Matrix (3 n, 3 n) of one environment's blocks (n_blocks, 3, 3)."""
        shape = (3 * self.n, 3 * self.n)
        return sparse.bsr_array((blocks, self.host_columns, self.host_row_starts), shape=shape).tocsr()


def corners_to_nodes(tetrahedra: np.ndarray, n_nodes: int, n_corners: int) -> sparse.csr_array:
    """Interpolation (nodes, corners) of linear fields to the nodes of tetrahedra (e, 10)."""
    middles, first = np.unique(tetrahedra[:, 4:].ravel(), return_index=True)
    ends = tetrahedra[:, TET_EDGES].reshape(-1, 2)[first]
    rows = np.concatenate([np.arange(n_corners), middles, middles])
    columns = np.concatenate([np.arange(n_corners), ends[:, 0], ends[:, 1]])
    values = np.where(rows < n_corners, 1.0, 0.5)
    return sparse.csr_array((values, (rows, columns)), shape=(n_nodes, n_corners))
