"""The convolution against another implementation, its gradients against finite differences."""

import numpy as np
import pytest
import torch
from scipy.sparse import csr_array

from simgen.learning.networks.chebyshev import ChebyshevConvolution, scaled_laplacian
from simgen.learning.networks.sparse import SparseMatrix, multiply

VERTICES, SAMPLES, ORDER = 30, 4, 6
WIDTHS = [(3, 16), (16, 16), (16, 3)]  # more outputs, as many, fewer: three ways through the code


@pytest.fixture
def adjacency() -> csr_array:
    rng = np.random.default_rng(0)
    dense = np.triu(rng.random((VERTICES, VERTICES)) < 0.2, 1)
    return csr_array((dense | dense.T).astype(float))


@pytest.fixture
def laplacian(adjacency) -> SparseMatrix:
    return as_module(scaled_laplacian(adjacency))


def as_module(matrix: csr_array) -> SparseMatrix:
    module = SparseMatrix(*matrix.shape, matrix.nnz)
    module.fill(matrix)
    return module


def test_laplacian_is_symmetric_with_its_spectrum_in_one(adjacency):
    dense = scaled_laplacian(adjacency).toarray()
    spectrum = np.linalg.eigvalsh(dense)
    np.testing.assert_array_equal(dense, dense.T)
    assert spectrum[0] == pytest.approx(-1.0)  # of sqrt(degree), the smoothest field
    assert spectrum[-1] <= 1.0


@pytest.mark.parametrize("add", [False, True])
def test_product_is_that_of_the_dense_matrix_into_part_of_a_tensor(adjacency, laplacian, add):
    dense = torch.randn(VERTICES, 7)
    before = torch.full((VERTICES, 3, 7), 1.0 if add else torch.nan)  # what is overwritten is not read
    whole = before.clone()
    multiply(laplacian, dense, out=whole[:, 1], add=add)
    matrix = torch.from_numpy(scaled_laplacian(adjacency).toarray()).float()
    torch.testing.assert_close(whole[:, 1], matrix @ dense + float(add))
    torch.testing.assert_close(whole[:, ::2], before[:, ::2], rtol=0, atol=0, equal_nan=True)


@pytest.mark.parametrize("widths", WIDTHS)
@pytest.mark.parametrize("bias", [True, False])
def test_values_and_gradients_are_those_of_torch_geometric(adjacency, laplacian, widths, bias):
    geometric = pytest.importorskip("torch_geometric.nn")
    ours = ChebyshevConvolution(*widths, ORDER, bias)
    theirs = geometric.ChebConv(*widths, ORDER, bias=bias)
    with torch.no_grad():
        for mine, linear in zip(ours.weight, theirs.lins, strict=True):
            linear.weight.copy_(mine)
        if bias:
            theirs.bias.copy_(ours.bias)
    x = torch.randn(VERTICES, widths[0], SAMPLES, requires_grad=True)
    same_x = x.detach().permute(2, 0, 1).clone().requires_grad_()
    edges = torch.from_numpy(np.stack(adjacency.nonzero()))
    y, same_y = ours(x, laplacian), theirs(same_x, edges, lambda_max=torch.tensor(2.0))
    towards = torch.randn_like(y)
    y.backward(towards)
    same_y.backward(towards.permute(2, 0, 1))
    pairs = [(y, same_y.permute(1, 2, 0)), (x.grad, same_x.grad.permute(1, 2, 0)),
             (ours.weight.grad, torch.stack([linear.weight.grad for linear in theirs.lins]))]  # fmt: skip
    if bias:
        pairs.append((ours.bias.grad, theirs.bias.grad))
    for mine, other in pairs:
        # Powers of L amplify rounding by up to 41 (sum of |coefficients| of T_5), relative to the largest value.
        torch.testing.assert_close(mine, other, rtol=0.0, atol=41 * 2**-23 * float(other.detach().abs().max()))


@pytest.mark.parametrize("rows", [VERTICES, 11])
@pytest.mark.parametrize("widths", WIDTHS)
@pytest.mark.parametrize("relu", [False, True])
def test_gradients_are_those_of_finite_differences(laplacian, widths, rows, relu):
    convolution = ChebyshevConvolution(*widths, 4).double()
    x = torch.randn(VERTICES, widths[0], 2, dtype=torch.float64, requires_grad=True)
    laplacian = laplacian.double()

    def output(x, weight, bias):
        return torch.func.functional_call(convolution, {"weight": weight, "bias": bias}, (x, laplacian, rows, relu))

    leaves = (x, convolution.weight.detach().requires_grad_(), convolution.bias.detach().requires_grad_())
    assert torch.autograd.gradcheck(output, leaves, fast_mode=True)


@pytest.mark.parametrize("widths", WIDTHS)
def test_the_first_rows_are_those_of_the_whole(laplacian, widths):
    convolution = ChebyshevConvolution(*widths)
    x = torch.randn(VERTICES, widths[0], SAMPLES)
    torch.testing.assert_close(convolution(x, laplacian, rows=11), convolution(x, laplacian)[:11])


@pytest.mark.parametrize("widths", WIDTHS)
def test_a_relu_keeps_what_is_positive(laplacian, widths):
    convolution = ChebyshevConvolution(*widths)
    x = torch.randn(VERTICES, widths[0], SAMPLES)
    assert torch.equal(convolution(x, laplacian, relu=True), convolution(x, laplacian).clamp_min(0.0))


@pytest.mark.parametrize("widths", WIDTHS)
@pytest.mark.parametrize("relu", [False, True])
def test_weights_alone_have_the_same_gradients(laplacian, widths, relu):
    """Fewer vertices are read where x needs no gradient, as for the displacements that the first layer takes."""
    convolution, x = ChebyshevConvolution(*widths), torch.randn(VERTICES, widths[0], SAMPLES)
    found = []
    for needs in (False, True):
        convolution.zero_grad()
        convolution(x.clone().requires_grad_(needs), laplacian, 11, relu).square().sum().backward()
        found.append([each.grad.clone() for each in convolution.parameters()])
    for one, other in zip(*found, strict=True):
        torch.testing.assert_close(one, other)


def test_a_filter_of_order_k_reaches_k_less_one_edges_far():
    chain = csr_array(np.eye(VERTICES, k=1) + np.eye(VERTICES, k=-1))
    x = torch.zeros(VERTICES, 1, 1)
    x[0] = 1.0
    y = ChebyshevConvolution(1, 1, ORDER, bias=False)(x, as_module(scaled_laplacian(chain)))
    assert torch.equal(torch.nonzero(y[:, 0, 0])[:, 0], torch.arange(ORDER))


def test_new_weights_are_normal_with_a_deviation_of_a_tenth():
    weight = ChebyshevConvolution(64, 64).weight
    assert abs(float(weight.detach().std()) - 0.1) < 5 * 0.1 / (2 * weight.numel()) ** 0.5  # five standard errors
