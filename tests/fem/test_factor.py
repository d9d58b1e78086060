"""Sparse factors: what they solve, in whatever order."""

import numpy as np
import pytest
import scipy.sparse as sparse

from simgen.errors import InputError
from simgen.fem.factor import FACTORS, Singular, SuperLU, elimination_order


def laplacian(n: int) -> sparse.csc_matrix:
    """Five-point Laplacian of an n x n grid, a little unsymmetric in its values."""
    line = sparse.diags_array([-1.0, 2.05, -0.9], offsets=[-1, 0, 1], shape=(n, n))
    return sparse.csc_matrix(sparse.kronsum(line, line))


@pytest.mark.parametrize("name", FACTORS)
def test_a_factor_solves(name):
    if name == "pardiso":
        pytest.importorskip("pypardiso")
    A = laplacian(20)
    x = np.random.default_rng(0).normal(size=A.shape[0])
    np.testing.assert_allclose(FACTORS[name](A).solve(A @ x), x, rtol=0.0, atol=1e-4)  # float32, condition ~100


def test_a_singular_matrix_has_no_factor():
    with pytest.raises(Singular):
        SuperLU(sparse.csc_matrix(np.diag([1.0, 0.0])))


def test_a_missing_package_is_one_line(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pypardiso", None)
    with pytest.raises(InputError, match="allowed: superlu"):
        FACTORS["pardiso"](laplacian(3))


def test_nested_dissection_fills_less_than_the_natural_order():
    graph = sparse.csr_array(laplacian(40))
    order = elimination_order(graph)
    assert sorted(order) == list(range(1600))
    natural = SuperLU(sparse.csc_matrix(graph))._factor.L.nnz
    dissected = SuperLU(sparse.csc_matrix(graph[order][:, order]))._factor.L.nnz
    assert dissected < 0.5 * natural  # n^2 log n against n^3: 0.3 here
