"""The coarse matrix and its corrections."""


import numpy as np
import scipy.sparse as sparse
import warp as wp

from simgen.fem import blocks
from simgen.fem.batch_arrays import ActiveEnvironments
from simgen.fem.linear_solver.aggregation import coarse_space
from simgen.fem.linear_solver.coarse_level import CoarseLevel
from simgen.fem.linear_solver.pattern import BlockPattern
from simgen.verification.validate.meshes import box
from tests.fem.linear_solver.clamped_block import SIZE


def test_the_coarse_matrix_is_that_of_the_motions():
    """In each environment its own, where it is active."""
    nodes, tets, n, _ = box((9, 9, 9), SIZE)
    pattern = BlockPattern(n, tets[:, :4], [], "cpu")
    free = np.repeat(nodes[:n, 1] < 3.9, 3)
    space = coarse_space(pattern.graph(), nodes[:n], free)
    level = CoarseLevel(pattern, space, ActiveEnvironments(3, "cpu"))
    level.active.assign(np.array([0, 2, -1], dtype=np.int32))
    rng = np.random.default_rng(0)
    of_both, stacked = {}, blocks.zeros(pattern.n_blocks, 3, "cpu")
    host = stacked.numpy()
    for env in (0, 2):
        stiff = sparse.kron(sparse.diags_array(2.0 * np.bincount(pattern.host_columns)) - pattern.graph(), np.eye(3))
        scale = sparse.diags_array(rng.uniform(0.5, 2.0, 3 * n))
        of_both[env] = sparse.csr_array(scale @ stiff @ scale)
        as_blocks = of_both[env].tobsr((3, 3))
        as_blocks.sort_indices()
        host[0, :, env] = as_blocks.data.ravel()
    level.rebuild(stacked)
    residual = rng.normal(size=(3 * n, 3)).astype(np.float32)
    x = wp.zeros((3 * n, 3), dtype=wp.float32, device="cpu")
    for _ in range(2):  # a correction must not depend on the one before
        x.zero_()
        level.correct(wp.array(residual, dtype=wp.float32, device="cpu"), x)
    for env, matrix in of_both.items():
        exact = space @ np.linalg.solve((space.T @ matrix @ space).toarray(), space.T @ residual[:, env])
        np.testing.assert_allclose(x.numpy()[:, env], exact, atol=1e-4 * np.abs(exact).max())
    assert not x.numpy()[:, 1].any()
