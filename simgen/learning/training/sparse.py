"""Constant sparse matrices of a network, stored as dense buffers, so that any file of tensors holds them."""

import warnings

import numpy as np
import torch
from scipy.sparse import csr_array
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

for known in ("Sparse CSR tensor support is in beta", "Sparse invariant checks are implicitly disabled"):
    warnings.filterwarnings("ignore", message=known, category=UserWarning)


class SparseMatrix(nn.Module):
    """A matrix (rows, columns) of ``entries`` stored values in compressed rows; zero until `fill`."""

    def __init__(self, rows: int, columns: int, entries: int):
        super().__init__()
        self.shape = (rows, columns)
        self.register_buffer("row_starts", torch.zeros(rows + 1, dtype=torch.int32))
        self.register_buffer("columns", torch.zeros(entries, dtype=torch.int32))
        self.register_buffer("values", torch.zeros(entries))

    def fill(self, matrix: csr_array) -> None:
        """Copy a matrix of the same shape and number of entries."""
        matrix = matrix.sorted_indices()
        for buffer, array in ((self.row_starts, matrix.indptr), (self.columns, matrix.indices),
                              (self.values, matrix.data)):  # fmt: skip
            buffer.copy_(torch.from_numpy(np.asarray(array)))


def multiply(matrix: SparseMatrix, dense: Tensor, out: Tensor, add: bool = False) -> None:
    """Compute ``out`` = matrix @ dense, or ``out`` += matrix @ dense, for (., n) tensors with contiguous rows.

    Records no gradient, does not synchronise, and may be part of a CUDA graph.
    """
    arrays = (matrix.row_starts, matrix.columns, matrix.values)
    csr = torch.sparse_csr_tensor(*arrays, size=matrix.shape, check_invariants=False)
    torch.addmm(out, csr, dense, beta=1.0 if add else 0.0, out=out)


def product(matrix: SparseMatrix, transposed: SparseMatrix, dense: Tensor) -> Tensor:
    """Compute matrix @ dense, (rows, n), with a gradient."""
    return _Product.apply(dense, matrix, transposed)


class _Product(torch.autograd.Function):
    @staticmethod
    def forward(context, dense: Tensor, matrix: SparseMatrix, transposed: SparseMatrix) -> Tensor:
        context.transposed = transposed
        out = dense.new_empty(matrix.shape[0], dense.shape[1])
        multiply(matrix, dense, out)
        return out

    @staticmethod
    @once_differentiable
    def backward(context, gradient: Tensor):
        of_dense = gradient.new_empty(context.transposed.shape[0], gradient.shape[1])
        multiply(context.transposed, gradient.contiguous(), of_dense)
        return of_dense, None, None


def interpolate(x: Tensor, matrix: SparseMatrix, transposed: SparseMatrix) -> Tensor:
    """Append matrix @ x to x (vertex, feature, sample): from values on a level to values on the finer level."""
    return _Interpolation.apply(x, matrix, transposed)


class _Interpolation(torch.autograd.Function):
    @staticmethod
    def forward(context, x: Tensor, matrix: SparseMatrix, transposed: SparseMatrix) -> Tensor:
        context.transposed = transposed
        coarse = x.flatten(1)
        y = coarse.new_empty(len(x) + matrix.shape[0], coarse.shape[1])
        y[: len(x)] = coarse
        multiply(matrix, coarse, out=y[len(x) :])
        return y.view(-1, *x.shape[1:])

    @staticmethod
    @once_differentiable
    def backward(context, gradient: Tensor):
        kept = context.transposed.shape[0]
        below = gradient.flatten(1)
        of_x = below[:kept].clone()
        multiply(context.transposed, below[kept:], out=of_x, add=True)
        return of_x.view(kept, *gradient.shape[1:]), None, None
