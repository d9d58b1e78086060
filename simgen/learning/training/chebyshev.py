"""Chebyshev convolution on a graph, for whole batches at once.

Features of a batch are a tensor (vertex, feature, sample). One sparse product then serves all samples, and flattening
for a linear layer copies nothing.
"""

import numpy as np
import torch
import torch.nn.functional as F
from numpy.polynomial.chebyshev import cheb2poly
from scipy.sparse import csr_array, diags_array
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from simgen.learning.training.sparse import SparseMatrix, multiply

INITIAL = 0.1  # standard deviation of new weights and biases, as published with CoMA


def scaled_laplacian(adjacency: csr_array) -> csr_array:
    """Scaled Laplacian -D^-1/2 A D^-1/2 of a symmetric adjacency A with degrees D; its spectrum is in [-1, 1]."""
    scale = diags_array(1.0 / np.sqrt(np.maximum(adjacency.sum(axis=1), 1.0)))  # an isolated vertex has a row of zeros
    return csr_array(-(scale @ adjacency @ scale))


class ChebyshevConvolution(nn.Module):
    """Filters on a graph that are polynomials of its scaled Laplacian L (Defferrard et al., NeurIPS 2016):

        y = sum over k < K of W_k T_k(L) x, plus bias

    with x (vertex, inputs, sample), y (vertex, outputs, sample) and ``weight`` (K, outputs, inputs). Callers pass L, so
    that convolutions on one graph share it. Weights start from N(0, 0.1), as in CoMA (Ranjan et al., ECCV 2018).
    """

    def __init__(self, inputs: int, outputs: int, order: int = 6, bias: bool = True):
        super().__init__()
        self.weight = nn.Parameter(torch.empty(order, outputs, inputs))
        self.bias = nn.Parameter(torch.empty(outputs)) if bias else None
        # Row k: coefficients of T_k in powers of L. Powers need products alone, and cost some bits: |T_5| sums to 41.
        powers = [np.pad(cheb2poly(np.eye(order)[k, : k + 1]), (0, order - 1 - k)) for k in range(order)]
        powers = torch.tensor(np.array(powers), dtype=torch.get_default_dtype())
        self.register_buffer("powers", powers, persistent=False)
        for parameter in self.parameters():
            nn.init.normal_(parameter, 0.0, INITIAL)

    def forward(self, x: Tensor, laplacian: SparseMatrix, rows: int | None = None) -> Tensor:
        """Convolve x, and return y at the first ``rows`` vertices, all by default: down-sampling drops the others."""
        weight = torch.einsum("kp,koi->poi", self.powers, self.weight)
        y = _Convolution.apply(x, weight, laplacian, len(x) if rows is None else rows)
        return y if self.bias is None else y.add_(self.bias[:, None])


class _Convolution(torch.autograd.Function):
    """sum over p of W_p L^p x, with few sparse products and little memory.

    Sparse products act on the side with fewer features: on inputs as powers, on outputs by Horner's rule. As L is
    symmetric, powers of the gradient of y give the gradients of both x and W. Powers of x are kept for the backward
    pass where they are smaller.
    """

    @staticmethod
    def forward(context, x: Tensor, weight: Tensor, laplacian: SparseMatrix, rows: int) -> Tensor:
        context.laplacian, context.widens = laplacian, weight.shape[2] < weight.shape[1]
        if weight.shape[2] > weight.shape[1]:
            y = horner(x, weight, laplacian)[:rows].clone()
        else:
            powers = powers_of(x, laplacian, len(weight))
            y = filtered(powers[:rows], weight)
        context.save_for_backward(powers if context.widens else x, weight)
        return y

    @staticmethod
    @once_differentiable
    def backward(context, gradient: Tensor):
        kept, weight = context.saved_tensors
        missing = len(kept) - len(gradient)
        gradient = F.pad(gradient, (0, 0, 0, 0, 0, missing)) if missing else gradient.contiguous()
        to_inputs = weight.transpose(1, 2)
        if context.widens:
            of_weight = correlated(kept, gradient).transpose(1, 2)
            of_x = horner(gradient, to_inputs, context.laplacian) if context.needs_input_grad[0] else None
        else:
            powers = powers_of(gradient, context.laplacian, len(weight))
            of_weight = correlated(powers, kept)
            of_x = filtered(powers, to_inputs) if context.needs_input_grad[0] else None
        return of_x, of_weight, None, None


def powers_of(x: Tensor, laplacian: SparseMatrix, count: int) -> Tensor:
    """Powers x, L x, L^2 x, ... of x (vertex, feature, sample): (vertex, power, feature, sample)."""
    vertices, features, samples = x.shape
    powers = x.new_empty(vertices, count, features * samples)
    powers[:, 0] = x.reshape(vertices, -1)
    for p in range(1, count):
        multiply(laplacian, powers[:, p - 1], out=powers[:, p])
    return powers.view(vertices, count, features, samples)


def horner(x: Tensor, weight: Tensor, laplacian: SparseMatrix) -> Tensor:
    """Horner's rule W_0 x + L (W_1 x + L (W_2 x + ...)), with ``weight`` (power, output, input)."""
    vertices, inputs, samples = x.shape
    count, outputs, _ = weight.shape
    terms = torch.bmm(weight.reshape(1, -1, inputs).expand(vertices, -1, -1), x)
    terms = terms.view(vertices, count, outputs * samples)
    for p in reversed(range(count - 1)):
        multiply(laplacian, terms[:, p + 1], out=terms[:, p], add=True)
    return terms[:, 0].view(vertices, outputs, samples)


def filtered(powers: Tensor, weight: Tensor) -> Tensor:
    """Sum of W_p times power p: (vertex, output, sample)."""
    flat = weight.transpose(0, 1).flatten(1)
    return torch.bmm(flat.expand(len(powers), -1, -1), powers.flatten(1, 2))


def correlated(powers: Tensor, x: Tensor) -> Tensor:
    """Sum of products over vertices and samples: (power, feature of ``powers``, feature of ``x``)."""
    products = torch.bmm(powers.flatten(1, 2), x.transpose(1, 2)).sum(dim=0)
    return products.view(powers.shape[1], powers.shape[2], x.shape[1])
