"""Prolongation and restriction against SciPy's products."""

import numpy as np
import scipy.sparse as sparse
import warp as wp

from simgen.fem.batch_arrays import ActiveEnvironments
from simgen.fem.linear_solver.transfer import Transfer


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
