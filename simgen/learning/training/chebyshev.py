"""Chebyshev convolution on a graph, for whole batches at once.

Features of a batch are a tensor (vertex, feature, sample): one sparse product then serves all samples, and flattening
them for a linear layer moves nothing.
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
    """-D^-1/2 A D^-1/2 of a symmetric adjacency: the normalised Laplacian less the identity, spectrum in [-1, 1]."""
    scale = diags_array(1.0 / np.sqrt(np.maximum(adjacency.sum(axis=1), 1.0)))  # a vertex alone has a row of zeros
    return csr_array(-(scale @ adjacency @ scale))


class ChebyshevConvolution(nn.Module):
    """Filters on a graph that are polynomials of its scaled Laplacian L (Defferrard et al., NeurIPS 2016):

        y = sum over k < K of W_k T_k(L) x, plus bias

    of x (vertex, inputs, sample), with ``weight`` (K, outputs, inputs), to y (vertex, outputs, sample). L is the
    caller's: convolutions on one graph share it. Starts at N(0, 0.1), as CoMA does (Ranjan et al., ECCV 2018).
    """

    def __init__(self, inputs: int, outputs: int, order: int = 6, bias: bool = True):
        super().__init__()
        self.weight = nn.Parameter(torch.empty(order, outputs, inputs))
        self.bias = nn.Parameter(torch.empty(outputs)) if bias else None
        # Row k: T_k as powers of L, which take products alone. They cost some bits: entries of T_5 sum to 41 in size.
        powers = [np.pad(cheb2poly(np.eye(order)[k, : k + 1]), (0, order - 1 - k)) for k in range(order)]
        powers = torch.tensor(np.array(powers), dtype=torch.get_default_dtype())
        self.register_buffer("powers", powers, persistent=False)
        for parameter in self.parameters():
            nn.init.normal_(parameter, 0.0, INITIAL)

    def forward(self, x: Tensor, laplacian: SparseMatrix, rows: int | None = None) -> Tensor:
        """y at the first ``rows`` vertices: the others may be left out where down-sampling comes next."""
        weight = torch.einsum("kp,koi->poi", self.powers, self.weight)
        y = _Convolution.apply(x, weight, laplacian, len(x) if rows is None else rows)
        return y if self.bias is None else y.add_(self.bias[:, None])


class _Convolution(torch.autograd.Function):
    """sum over p of W_p L^p x, with few sparse products and little memory.

    Sparse products are made on the side that has fewer features: on the inputs as powers, on the outputs by Horner's
    rule. As L is symmetric, powers of the gradient of y give the gradients of x and of W alike; powers of x, where
    these are smaller, are kept for it.
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
    """x, L x, L^2 x, ...: (vertex, feature, sample) -> (vertex, power, feature, sample)."""
    vertices, features, samples = x.shape
    powers = x.new_empty(vertices, count, features * samples)
    powers[:, 0] = x.reshape(vertices, -1)
    for p in range(1, count):
        multiply(laplacian, powers[:, p - 1], out=powers[:, p])
    return powers.view(vertices, count, features, samples)


def horner(x: Tensor, weight: Tensor, laplacian: SparseMatrix) -> Tensor:
    """W_0 x + L (W_1 x + L (W_2 x + ...)), with ``weight`` (power, output, input)."""
    vertices, inputs, samples = x.shape
    count, outputs, _ = weight.shape
    terms = torch.bmm(weight.reshape(1, -1, inputs).expand(vertices, -1, -1), x)
    terms = terms.view(vertices, count, outputs * samples)
    for p in reversed(range(count - 1)):
        multiply(laplacian, terms[:, p + 1], out=terms[:, p], add=True)
    return terms[:, 0].view(vertices, outputs, samples)


def filtered(powers: Tensor, weight: Tensor) -> Tensor:
    """Sum over powers of W_p times the power: -> (vertex, output, sample)."""
    flat = weight.transpose(0, 1).flatten(1)
    return torch.bmm(flat.expand(len(powers), -1, -1), powers.flatten(1, 2))


def correlated(powers: Tensor, x: Tensor) -> Tensor:
    """Products summed over vertices and samples: (power, feature of ``powers``, feature of ``x``)."""
    products = torch.bmm(powers.flatten(1, 2), x.transpose(1, 2)).sum(dim=0)
    return products.view(powers.shape[1], powers.shape[2], x.shape[1])
