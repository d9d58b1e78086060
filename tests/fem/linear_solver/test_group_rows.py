"""Rows of groups of environments against rows of one environment after the other: the same bytes."""

import numpy as np
import pytest
import scipy.sparse as sparse
import warp as wp

from simgen.fem import batch_arrays
from simgen.fem.batch_arrays import ActiveEnvironments
from simgen.fem.groups import WIDTH
from simgen.fem.linear_solver import rounded_blocks
from simgen.fem.linear_solver.linear_multigrid import (
    chebyshev_kernel,
    group_chebyshev_kernel,
    group_residual_kernel,
    residual_kernel,
)
from simgen.fem.linear_solver.transfer import group_sparse_kernel, sparse_kernel

N, N_ENV = 37, 5 * WIDTH + 3  # rows; more environments than a tile of blocks
CHOSEN = [np.arange(N_ENV), [1, 2, 4, 7, 8, 15, 32, 33, 34, 35, 40, 41, 42], [3]]


@pytest.fixture(scope="module")
def rng():
    return np.random.default_rng(0)


@pytest.fixture(scope="module")
def graph(rng):
    """Rows with a diagonal entry and others, except for the first one, which has none."""
    full = sparse.random_array((N, N), density=0.2, rng=rng) + sparse.eye_array(N)
    return sparse.csr_array(sparse.diags_array((np.arange(N) > 0).astype(float)) @ full)


def on_device(values, dtype=wp.float32):
    return wp.array(values, dtype=dtype, device="cpu")


def assert_same(chosen, rows, kernel, group_kernel, inputs, outputs):
    """Both kernels leave the same bytes; they change the chosen environments and no others."""
    active = ActiveEnvironments.of(np.isin(np.arange(N_ENV), chosen), "cpu")
    results, before = [], [output.numpy().copy() for output in outputs]
    for each, whole_rows in ((kernel, False), (group_kernel, True)):
        own = [on_device(values) for values in before]
        batch_arrays.launch(each, rows, [*inputs, active], own, whole_rows)
        results.append([output.numpy() for output in own])
    for one, group, values in zip(*results, before, strict=True):
        assert one.tobytes() == group.tobytes()
        assert ((one != values).any(axis=0) == np.isin(np.arange(N_ENV), chosen)).all()


@pytest.mark.parametrize("chosen", CHOSEN)
@pytest.mark.parametrize("keep", [0.0, 0.7])
def test_smoothing(rng, graph, chosen, keep):
    blocks = rounded_blocks.zeros(graph.nnz, N_ENV, "cpu")
    inverse = rounded_blocks.zeros(N, N_ENV, "cpu")
    for each in (blocks, inverse):
        numbers = rng.normal(size=each.shape).astype(np.float32)
        each.assign((numbers.view(np.uint32) >> 16).astype(np.uint16))
    rows = [on_device(graph.indptr, wp.int32), on_device(graph.indices, wp.int32), blocks]
    x, b, direction, out = (on_device(rng.normal(size=(3 * N, N_ENV))) for _ in range(4))
    inputs = [*rows, inverse, x, b, keep, 0.3]
    assert_same(chosen, N, chebyshev_kernel, group_chebyshev_kernel, inputs, [direction, out])
    assert_same(chosen, N, residual_kernel, group_residual_kernel, [*rows, x, b], [out])


@pytest.mark.parametrize("chosen", CHOSEN)
@pytest.mark.parametrize("keep", [False, True])
def test_transfer(rng, graph, chosen, keep):
    matrix = [on_device(a, wp.int32) for a in (graph.indptr, graph.indices)] + [on_device(graph.data)]
    x, y = (on_device(rng.normal(size=(N, N_ENV))) for _ in range(2))
    assert_same(chosen, N, sparse_kernel, group_sparse_kernel, [*matrix, x, -1.5, keep], [y])
