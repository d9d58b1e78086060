"""Sparse products against scipy's, and gradients against finite differences."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.sparse
import torch

from simgen.learning.networks import sparse
from simgen.learning.networks.sparse import SparseMatrix, interpolate, multiply, product, tf32_kernels


def random(rows: int, columns: int, seed: int = 0) -> scipy.sparse.csr_array:
    return scipy.sparse.random_array((rows, columns), density=0.4, rng=np.random.default_rng(seed), format="csr")


def filled(matrix: scipy.sparse.csr_array) -> SparseMatrix:
    found = SparseMatrix(*matrix.shape, matrix.nnz).double()
    found.fill(matrix)
    return found


@pytest.mark.parametrize("add", [False, True])
def test_a_product_is_scipy_s(add):
    matrix, dense = random(5, 7), torch.randn(7, 3, dtype=torch.float64)
    out = torch.ones(5, 3, dtype=torch.float64)
    multiply(filled(matrix), dense, out, add)
    np.testing.assert_allclose(out, matrix @ dense.numpy() + add, rtol=1e-12)


def test_unsorted_columns_are_the_same_matrix():
    matrix = scipy.sparse.csr_array((np.array([2.0, 1.0, 3.0]), np.array([2, 0, 1]), np.array([0, 2, 3])), (2, 3))
    out = torch.empty(2, 3, dtype=torch.float64)
    multiply(filled(matrix), torch.eye(3, dtype=torch.float64), out)
    np.testing.assert_array_equal(out, [[1.0, 0.0, 2.0], [0.0, 3.0, 0.0]])


def test_a_matrix_that_is_not_filled_is_zero():
    out = torch.ones(2, 2)
    multiply(SparseMatrix(2, 3, 4), torch.ones(3, 2), out)
    assert not out.any()


def test_interpolated_values_stand_below_their_sources():
    matrix = random(4, 6)
    x = torch.randn(6, 2, 3, dtype=torch.float64, requires_grad=True)
    own = filled(matrix), filled(matrix.T.tocsr())
    y = interpolate(x, *own).detach()
    assert torch.equal(y[:6], x)
    np.testing.assert_allclose(y[6:].flatten(1), matrix @ x.detach().flatten(1).numpy(), rtol=1e-12)
    assert torch.autograd.gradcheck(lambda values: interpolate(values, *own), x)


def test_a_product_has_a_gradient():
    matrix = random(4, 6)
    x = torch.randn(6, 3, dtype=torch.float64, requires_grad=True)
    own = filled(matrix), filled(matrix.T.tocsr())
    np.testing.assert_allclose(product(*own, x).detach(), matrix @ x.detach().numpy(), rtol=1e-12)
    assert torch.autograd.gradcheck(lambda values: product(*own, values), x)


def test_blocks_follow_the_matrix_and_are_no_state():
    """They are kept, until the matrix is filled anew, read from a file or moved."""
    matrix, other = random(5, 7), 2.0 * random(5, 7)
    found = SparseMatrix(5, 7, matrix.nnz)
    assert not found.blocks.values.numel()
    found.fill(matrix)
    first = found.blocks
    assert first is found.blocks
    for change in (lambda: found.fill(other), lambda: found.load_state_dict(found.state_dict()), found.float):
        change()
        assert found.blocks is not first
        torch.testing.assert_close(found.blocks.values, 2.0 * first.values)
    assert set(found.state_dict()) == {"row_starts", "columns", "values"}


def test_a_cpu_has_no_kernels(monkeypatch):
    monkeypatch.setattr(torch, "get_float32_matmul_precision", lambda: "high")
    monkeypatch.setattr(sparse, "_kernels", lambda: "kernels")
    assert tf32_kernels(torch.ones(2, 2)) is None


def test_kernels_that_fail_are_not_used(monkeypatch):
    """As on a machine without a C compiler."""

    def filtered(*_):
        raise RuntimeError("Failed to find C compiler")

    zeros = torch.zeros
    monkeypatch.setattr(torch, "zeros", lambda shape, device: zeros(shape))
    monkeypatch.setattr(torch.version, "cuda", "13.0")
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda: (9, 0))
    monkeypatch.setattr(sparse.util, "find_spec", lambda name: name == "triton")
    monkeypatch.setattr(sparse, "import_module", lambda name: SimpleNamespace(filtered=filtered))
    with pytest.warns(UserWarning, match="Triton does not run here, training takes longer: Failed to find C compiler"):
        assert sparse._kernels.__wrapped__() is None
    monkeypatch.setattr(sparse, "import_module", lambda name: SimpleNamespace(filtered=lambda *_: None))
    assert sparse._kernels.__wrapped__() is not None
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda: (7, 5))  # Turing has no TF32
    assert sparse._kernels.__wrapped__() is None
