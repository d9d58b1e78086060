"""Constant sparse matrices of a network, stored as dense buffers, so that any file of tensors holds them."""

import warnings
from functools import cache
from importlib import import_module, util
from types import ModuleType
from typing import Any

import numpy as np
import torch
from scipy.sparse import csr_array
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from simgen.errors import shown
from simgen.learning.networks.sparse_blocks import SparseBlocks

KERNELS = "simgen.learning.networks.tf32_kernels"  # imports Triton
FIRST_TF32 = (8, 0)  # compute capability: Ampere

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
        self._blocks: SparseBlocks | None = None

    def fill(self, matrix: csr_array) -> None:
        """Copy a matrix of the same shape and number of entries."""
        matrix = matrix.sorted_indices()
        for buffer, array in ((self.row_starts, matrix.indptr), (self.columns, matrix.indices),
                              (self.values, matrix.data)):  # fmt: skip
            buffer.copy_(torch.from_numpy(np.asarray(array)))
        self._blocks = None

    @property
    def blocks(self) -> SparseBlocks:
        """Blocks of the matrix, made when first needed. A CUDA graph that is being recorded must not be the first."""
        if self._blocks is None:
            entries = (each.cpu().numpy() for each in (self.values, self.columns, self.row_starts))
            self._blocks = SparseBlocks.of_matrix(csr_array(tuple(entries), self.shape), self.values.device)
        return self._blocks

    def _apply(self, *arguments: Any, **named: Any) -> nn.Module:
        self._blocks = None  # they are made anew on the next device
        return super()._apply(*arguments, **named)

    def _load_from_state_dict(self, *arguments: Any, **named: Any) -> None:
        self._blocks = None
        super()._load_from_state_dict(*arguments, **named)


def tf32_kernels(x: Tensor) -> ModuleType | None:
    """Return `simgen.learning.networks.tf32_kernels` if it runs here and products with x may have TF32's precision.

    As for torch's own products, `torch.set_float32_matmul_precision` allows that, see
    `simgen.learning.training.step.tf32_products`.
    """
    allowed = x.is_cuda and x.dtype == torch.float32 and torch.get_float32_matmul_precision() != "highest"
    return _kernels() if allowed else None


def triton_runs() -> bool:
    """Return True if Triton can compile kernels here: on NVIDIA GPUs since Ampere, with a C compiler."""
    return _kernels() is not None


@cache
def _kernels() -> ModuleType | None:
    if torch.version.cuda is None or torch.cuda.get_device_capability() < FIRST_TF32 or not util.find_spec("triton"):
        return None
    kernels = import_module(KERNELS)
    try:
        kernels.filtered(*(torch.zeros(shape, device="cuda") for shape in ((1, 1, 1), (1, 1, 1, 1), (2, 1, 1))), 1)
    except Exception as error:  # Triton needs a C compiler and Python's headers, and says so in many ways
        warnings.warn(f"Triton does not run here, training takes longer: {shown(str(error), 200)}", stacklevel=2)
        return None
    return kernels


def multiply(matrix: SparseMatrix, dense: Tensor, out: Tensor, add: bool = False) -> None:
    """Compute ``out`` = matrix @ dense, or ``out`` += matrix @ dense, for (., n) tensors with contiguous rows.

    Records no gradient and may be part of a CUDA graph, if it ran once before.
    """
    if kernels := tf32_kernels(dense):
        kernels.multiply_blocks(matrix.blocks, matrix.shape[0], dense, out, add)
        return
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
