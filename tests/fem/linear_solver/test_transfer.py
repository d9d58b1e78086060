"""Prolongation and restriction against SciPy's products."""

import numpy as np
import scipy.sparse as sparse
import warp as wp

from simgen.fem.batch_arrays import ActiveEnvironments
from simgen.fem.linear_solver.transfer import LONG_ROW, PART, Transfer


def test_products_replace_or_add_in_active_environments():
    rng, active = np.random.default_rng(0), np.array([True, False, True])
    matrix = sparse.random_array((9, 4), density=0.4, rng=rng, format="csr")
    transfer = Transfer(matrix, ActiveEnvironments.of(active, "cpu"))
    fine, coarse = (rng.normal(size=(n, 3)).astype(np.float32) for n in (9, 4))
    y = wp.array(fine, dtype=wp.float32, device="cpu")
    transfer.add_prolonged(wp.array(coarse, dtype=wp.float32, device="cpu"), y)
    np.testing.assert_allclose(y.numpy(), fine + active * (matrix @ coarse), atol=1e-6)
    y = wp.array(fine, dtype=wp.float32, device="cpu")
    transfer.prolong(wp.array(coarse, dtype=wp.float32, device="cpu"), y)
    np.testing.assert_allclose(y.numpy(), np.where(active, matrix @ coarse, fine), atol=1e-6)
    y = wp.array(coarse, dtype=wp.float32, device="cpu")
    transfer.restrict(wp.array(fine, dtype=wp.float32, device="cpu"), y, -2.0)
    np.testing.assert_allclose(y.numpy(), np.where(active, -2.0 * (matrix.T @ fine), coarse), atol=1e-6)


def test_threads_that_share_long_rows_restrict_as_one_thread_does(monkeypatch):
    """As on a GPU in few environments. The last row has no numbers, others have more than one part."""
    monkeypatch.setattr(ActiveEnvironments, "few", True)
    rng, active = np.random.default_rng(1), np.array([True, False, True])
    matrix = sparse.random_array((150, 5), density=0.5, rng=rng, format="csr")
    matrix = sparse.hstack([matrix, sparse.csr_array((150, 1))], format="csr")
    transfer = Transfer(matrix, ActiveEnvironments.of(active, "cpu"))
    longest = int(np.diff(matrix.tocsc().indptr).max())
    assert transfer._parts == -(-longest // PART) > 2
    fine, coarse = (rng.normal(size=(n, 3)).astype(np.float32) for n in (150, 6))
    y = wp.array(coarse, dtype=wp.float32, device="cpu")
    transfer.restrict(wp.array(fine, dtype=wp.float32, device="cpu"), y, -2.0)
    np.testing.assert_allclose(y.numpy(), np.where(active, -2.0 * (matrix.T @ fine), coarse), atol=1e-5)


def test_only_long_rows_are_shared():
    for entries, parts in ((LONG_ROW - 1, 1), (LONG_ROW, LONG_ROW // PART)):
        matrix = sparse.csr_array(np.ones((entries, 1)))
        assert Transfer(matrix, ActiveEnvironments(1, "cpu"))._parts == parts
