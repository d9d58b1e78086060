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

from simgen.learning.networks.sparse import SparseMatrix, multiply, tf32_kernels

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

    def forward(self, x: Tensor, laplacian: SparseMatrix, rows: int | None = None, relu: bool = False) -> Tensor:
        """Convolve x, and return y at the first ``rows`` vertices, all by default: down-sampling drops the others.

        relu : return max(y, 0)
        """
        weight = torch.einsum("kp,koi->poi", self.powers, self.weight)
        return _Convolution.apply(x, weight, self.bias, laplacian, len(x) if rows is None else rows, relu)


class _Convolution(torch.autograd.Function):
    """sum over p of W_p L^p x plus bias, with few sparse products and little memory.

    Sparse products act on the side with fewer features: on inputs as powers, on outputs by Horner's rule. As L is
    symmetric, powers of the gradient of y give the gradients of both x and W. Powers of x are kept for the backward
    pass where they are smaller.
    """

    @staticmethod
    def forward(
        context, x: Tensor, weight: Tensor, bias: Tensor | None, laplacian: SparseMatrix, rows: int, relu: bool
    ) -> Tensor:
        context.laplacian, context.biased = laplacian, bias is not None
        context.widens = weight.shape[2] < weight.shape[1]
        x, powers = x.contiguous(), None
        if weight.shape[2] > weight.shape[1]:
            y = activated(horner(x, weight, laplacian)[:rows].clone(), bias, relu)
        else:
            powers = powers_of(x, laplacian, len(weight))
            y = filtered(x, powers, weight, rows, bias, relu)
        context.save_for_backward(x, weight, powers if context.widens else None, y if relu else None)
        return y

    @staticmethod
    @once_differentiable
    def backward(context, gradient: Tensor):
        x, weight, powers, y = context.saved_tensors
        to_inputs, of_x, kept = weight.transpose(1, 2), None, len(gradient)
        needs_all = context.needs_input_grad[0] or not context.widens
        gradient = masked(gradient, y, len(x) if needs_all else kept)
        if context.widens:
            of_weight = correlated(x, powers, gradient[:kept])[0].transpose(1, 2)
            of_bias = gradient.sum(dim=(0, 2)) if context.biased else None
            if context.needs_input_grad[0]:
                of_x = horner(gradient, to_inputs, context.laplacian)
        else:
            powers = powers_of(gradient, context.laplacian, len(weight))
            of_weight, of_bias = correlated(gradient, powers, x)
            if context.needs_input_grad[0]:
                of_x = filtered(gradient, powers, to_inputs, len(x))
        return of_x, of_weight, of_bias if context.biased else None, None, None, None


def powers_of(x: Tensor, laplacian: SparseMatrix, count: int) -> Tensor:
    """Powers L x, L^2 x, ... of x (vertex, feature, sample): (vertex, count - 1, feature, sample), without x."""
    vertices, features, samples = x.shape
    powers = x.new_empty(vertices, count - 1, features * samples)
    before = x.reshape(vertices, -1)
    for p in range(count - 1):
        multiply(laplacian, before, out=powers[:, p])
        before = powers[:, p]
    return powers.view(vertices, count - 1, features, samples)


def horner(x: Tensor, weight: Tensor, laplacian: SparseMatrix) -> Tensor:
    """Horner's rule W_0 x + L (W_1 x + L (W_2 x + ...)), with ``weight`` (power, output, input)."""
    vertices, inputs, samples = x.shape
    count, outputs, _ = weight.shape
    none = x.new_empty(vertices, 0, inputs, samples)
    terms = filtered(x, none, weight.reshape(1, -1, inputs), vertices).view(vertices, count, outputs * samples)
    for p in reversed(range(count - 1)):
        multiply(laplacian, terms[:, p + 1], out=terms[:, p], add=True)
    return terms[:, 0].view(vertices, outputs, samples)


def filtered(
    x: Tensor, powers: Tensor, weight: Tensor, rows: int, bias: Tensor | None = None, relu: bool = False
) -> Tensor:
    """Sum of W_p times power p at the first ``rows`` vertices, `activated`: (vertex, output, sample)."""
    if kernels := tf32_kernels(x):
        return kernels.filtered(x, powers, weight, rows, bias, relu)
    of_powers = weight[1:].transpose(0, 1).flatten(1).expand(rows, -1, -1)
    y = torch.bmm(weight[0].expand(rows, -1, -1), x[:rows])
    return activated(y.baddbmm_(of_powers, powers[:rows].flatten(1, 2)), bias, relu)


def activated(y: Tensor, bias: Tensor | None, relu: bool) -> Tensor:
    """Add ``bias`` (output,) to y (vertex, output, sample), then take its positive part, in place."""
    if bias is not None:
        y.add_(bias[:, None])
    return y.relu_() if relu else y


def masked(gradient: Tensor, y: Tensor | None, rows: int) -> Tensor:
    """Gradient before a ReLU of values y, if any, at ``rows`` vertices: 0 where y is 0, and at those that y lacks."""
    missing = rows - len(gradient)
    if y is None:
        return F.pad(gradient, (0, 0, 0, 0, 0, missing)) if missing else gradient.contiguous()
    whole = gradient.new_empty(rows, *gradient.shape[1:])
    whole[len(gradient) :] = 0.0
    torch.ops.aten.threshold_backward.grad_input(gradient, y, 0, grad_input=whole[: len(gradient)])
    return whole


def correlated(x: Tensor, powers: Tensor, other: Tensor) -> tuple[Tensor, Tensor]:
    """Sums of products of x and its powers with ``other`` over vertices and samples, and sums of x (feature,).

    Products are (power, feature of x, feature of ``other``). Vertices are those of ``other``.
    """
    if kernels := tf32_kernels(x):
        return kernels.correlated(x, powers, other)
    x, powers, by_sample = x[: len(other)], powers[: len(other)], other.transpose(1, 2)
    products = [torch.bmm(each.flatten(1, -2), by_sample).sum(dim=0) for each in (x, powers)]
    return torch.cat(products).view(-1, x.shape[1], other.shape[1]), x.sum(dim=(0, 2))
