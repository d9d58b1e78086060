"""Blocks of a sparse matrix: rows that share columns, so that a GPU reads each column once for all of them.

A row of a mesh's Laplacian has 12 entries. Blocks of 16 rows read 4 to 5 columns a row.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
import torch
from scipy.sparse import csr_array
from torch import Tensor

ROWS = 16  # of a block
COLUMNS = 16  # multiplied at a time


@dataclass(frozen=True)
class SparseBlocks:
    """Dense blocks of a sparse matrix (m, n), cut into chunks of `COLUMNS` columns.

    rows : (block, `ROWS`) row numbers; m fills the last block up
    starts : (block + 1,) first chunk of each block
    columns : (chunk, `COLUMNS`) column numbers; a repeated last one fills a chunk up, with zeros
    values : (chunk, `ROWS`, `COLUMNS`) entries, rounded to TF32
    """

    rows: Tensor
    starts: Tensor
    columns: Tensor
    values: Tensor

    @classmethod
    def of_matrix(cls, matrix: csr_array, device: torch.device) -> Self:
        """Cut a matrix (m, n) into blocks of rows that share columns, on a device."""
        order = grouped(matrix, ROWS)
        starts, chunks, values = [0], [np.zeros((0, COLUMNS))], [np.zeros((0, ROWS, COLUMNS))]
        for first in range(0, len(order), ROWS):
            part = matrix[order[first : first + ROWS]].tocsc()
            used = np.flatnonzero(np.diff(part.indptr))
            missing = -len(used) % COLUMNS
            entries = np.pad(part[:, used].toarray(), ((0, ROWS - part.shape[0]), (0, missing)))
            chunks.append(np.pad(used, (0, missing), mode="edge" if missing else "constant").reshape(-1, COLUMNS))
            values.append(entries.reshape(ROWS, -1, COLUMNS).transpose(1, 0, 2))
            starts.append(starts[-1] + len(chunks[-1]))
        order = np.pad(order, (0, -len(order) % ROWS), constant_values=matrix.shape[0]).reshape(-1, ROWS)
        numbers = (order, np.array(starts), np.concatenate(chunks))
        rounded = torch.from_numpy(tf32(np.concatenate(values)))
        return cls(*(torch.from_numpy(each.astype(np.int32)).to(device) for each in numbers), rounded.to(device))


def grouped(matrix: csr_array, size: int) -> np.ndarray:
    """Order (m,) of the rows of a matrix (m, n), in which each ``size`` of them share columns.

    Greedy: the next row adds the fewest columns to its group. The first row of a group is the one that would add the
    fewest to the group before.
    """
    columns = [set(each.tolist()) for each in np.split(matrix.indices, matrix.indptr[1:-1])]
    transposed = matrix.T.tocsr()
    rows = [each.tolist() for each in np.split(transposed.indices, transposed.indptr[1:-1])]
    order: list[int] = []
    free = dict.fromkeys(range(matrix.shape[0]))
    shared: dict[int, int] = {}  # columns that free rows share with the group
    reached: set[int] = set()
    while free:
        row = max(shared, key=lambda row: (shared[row] - len(columns[row]), shared[row]), default=next(iter(free)))
        if len(order) % size == 0:
            shared, reached = {}, set()
        order.append(row)
        del free[row]
        shared.pop(row, None)
        for column in columns[row] - reached:
            for other in rows[column]:
                if other in free:
                    shared[other] = shared.get(other, 0) + 1
        reached |= columns[row]
    return np.array(order)


def tf32(values: np.ndarray) -> np.ndarray:
    """Round to the ten bits of mantissa of TF32, halves away from zero."""
    return ((values.astype(np.float32).view(np.uint32) + 0x1000) & 0xFFFFE000).view(np.float32)
