"""Aggregates of corners, their rigid motions and the coarsest space."""


import numpy as np
import pytest

from simgen.fem.linear_solver.aggregation import coarse_space, largest_eigenvalue, rigid_motions
from simgen.fem.linear_solver.pattern import BlockPattern
from simgen.verification.validate.meshes import box
from tests.fem.linear_solver.clamped_block import SIZE


def test_the_largest_eigenvalue():
    values = np.array([0.1, 1.0, 2.0, 3.0])
    assert largest_eigenvalue(lambda v: values * v, 4) == pytest.approx(3.0, rel=1e-3)
    assert largest_eigenvalue(lambda v: 0.0 * v, 4) == 1.0



def test_rigid_motions_leave_distances():
    points = np.random.default_rng(0).normal(size=(20, 3))
    motions = rigid_motions(points)
    assert np.linalg.matrix_rank(motions) == 6
    for motion in motions.T.reshape(6, 20, 3):
        apart, moved = points[:, None] - points, motion[:, None] - motion
        np.testing.assert_allclose(np.einsum("abi,abi->ab", apart, moved), 0.0, atol=1e-13)



def test_aggregates_carry_rigid_motions():
    """If nothing is held, the coarse space holds them exactly."""
    nodes, tets, n, _ = box((9, 9, 9), SIZE)
    pattern = BlockPattern(n, tets[:, :4], [], "cpu")
    space = coarse_space(pattern.graph(), nodes[:n], np.ones(3 * n, dtype=bool))
    motions = rigid_motions(nodes[:n])
    assert space.shape[1] < 0.2 * 3 * n
    fitted = np.linalg.lstsq(space.toarray(), motions, rcond=None)[0]
    np.testing.assert_allclose(space @ fitted, motions, atol=1e-10 * np.abs(motions).max())



def test_a_coarse_space_keeps_out_of_what_is_held():
    nodes, tets, n, _ = box((9, 9, 9), SIZE)
    pattern = BlockPattern(n, tets[:, :4], [], "cpu")
    free = np.repeat(nodes[:n, 1] < 3.9, 3)
    free[::3] &= nodes[:n, 0] > -2.9  # a plane of symmetry
    space = coarse_space(pattern.graph(), nodes[:n], free)
    assert np.abs(space[np.flatnonzero(~free)]).max() == 0.0
    np.testing.assert_allclose((space.T @ space).toarray(), np.eye(space.shape[1]), atol=1e-12)
