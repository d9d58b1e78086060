"""The factor of linear tetrahedra inverts their tangent, and is made anew where it has become a poor one."""

import numpy as np
import scipy.sparse as sparse
import scipy.sparse.linalg
import warp as wp

from simgen.fem.batch_arrays import ActiveEnvironments
from simgen.fem.elements.elasticity import Elasticity
from simgen.fem.elements.element import P1
from simgen.fem.linear_solver.factor import REFACTOR_ABOVE, SparseFactor, elimination_order
from simgen.fem.material.neo_hookean import NeoHookean
from tests.fem.box import box

SINGLE = 1e-3  # single precision, times a condition of some thousands


def test_a_factor_inverts_the_tangent_it_was_made_of():
    nodes, tets, n_corners, _ = box()
    nodes = nodes[:n_corners]
    active = ActiveEnvironments(1, "cpu")
    body = Elasticity(P1, nodes, tets, n_corners, NeoHookean.from_engineering(1.0, 0.499, None), "cpu", active)
    fixed = np.repeat(nodes[:, 1] > 4.0 - 1e-9, 3)

    factor = SparseFactor(body, [], wp.array(fixed.astype(np.int32), dtype=wp.int32, device="cpu"), body.tangent)
    rng = np.random.default_rng(0)
    first, second = (np.where(fixed, 0.0, 0.05 * rng.normal(size=fixed.shape)) for _ in range(2))
    v = np.where(fixed, 0.0, rng.normal(size=fixed.shape))

    def error(x) -> float:
        """Relative error of K^-1 (K v) with the factor, K at state x."""
        body.linearize(wp.array(x[:, None], dtype=wp.float64, device="cpu"))
        force, found = (wp.zeros((len(v), 1), dtype=wp.float32, device="cpu") for _ in range(2))
        body.tangent(wp.array(v[:, None], dtype=wp.float32, device="cpu"), force)
        factor.apply(force, found)
        return np.linalg.norm(found.numpy()[:, 0] - v) / np.linalg.norm(v)

    body.linearize(wp.array(first[:, None], dtype=wp.float64, device="cpu"))
    assert len(factor.refactor(np.array([0]), np.array([0]))) == 0
    assert error(first) < SINGLE
    assert error(second) > 1e-2
    factor.refactor(np.array([0]), np.array([REFACTOR_ABOVE]))
    assert error(second) > 1e-2  # still good enough
    factor.refactor(np.array([0]), np.array([REFACTOR_ABOVE + 1]))
    assert error(second) < SINGLE
    factor.forget(np.array([True]))
    factor.refactor(np.array([0]), np.array([0]))
    assert error(second) < SINGLE


def test_a_singular_environment_is_named():
    nodes, tets, n_corners, _ = box()
    active = ActiveEnvironments(2, "cpu")
    nodes = nodes[:n_corners]
    body = Elasticity(P1, nodes, tets, n_corners, NeoHookean.from_engineering(1.0, 0.3, None), "cpu", active)
    fixed = np.zeros(3 * n_corners, dtype=np.int32)
    fixed[::3] = 1
    fixed[1::3] = 1
    fixed[2::3] = 1
    fixed[3 * n_corners - 1] = 0  # one component is free
    factor = SparseFactor(body, [], wp.array(fixed, dtype=wp.int32, device="cpu"), body.tangent)
    body.linearize(wp.zeros((3 * n_corners, 2), dtype=wp.float64, device="cpu"))
    body._single.volumes.zero_()
    np.testing.assert_array_equal(factor.refactor(np.array([1]), np.zeros(2)), [1])


def test_nested_dissection_fills_less_than_the_natural_order():
    line = sparse.diags_array([-1.0, 2.05, -0.9], offsets=[-1, 0, 1], shape=(40, 40))
    graph = sparse.csr_array(sparse.kronsum(line, line))
    order = elimination_order(graph)
    assert sorted(order) == list(range(1600))
    natural, dissected = (
        scipy.sparse.linalg.splu(sparse.csc_matrix(m), permc_spec="NATURAL", diag_pivot_thresh=0.0).L.nnz
        for m in (graph, graph[order][:, order])
    )
    assert dissected < 0.5 * natural  # n^2 log n against n^3: 0.3 here
