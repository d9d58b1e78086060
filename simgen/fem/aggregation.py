"""The coarsest space of the multigrid preconditioner: rigid motions of aggregates of corners, smoothed once.

Vanek, Mandel and Brezina, "Algebraic multigrid by smoothed aggregation for second and fourth order elliptic problems",
Computing 56, 1996. Aggregates and their bases are pyamg's.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
import scipy.sparse.linalg
from pyamg.aggregation import fit_candidates, standard_aggregation

SMALL = 600  # free unknowns up to which the coarsest space is the whole one
POWER_STEPS = 20


def rigid_motions(positions: np.ndarray) -> np.ndarray:
    """The six linearised rigid motions (3 n, 6) of points (n, 3)."""
    x = positions - positions.mean(axis=0)
    motions = np.zeros((len(x), 3, 6))
    for i in range(3):
        motions[:, i, i] = 1.0
        j, k = (i + 1) % 3, (i + 2) % 3
        motions[:, k, 3 + i], motions[:, j, 3 + i] = x[:, j], -x[:, k]
    return motions.reshape(-1, 6)


def largest_eigenvalue(apply, n: int) -> float:
    """Of a linear map (n,) -> (n,) with positive eigenvalues, by the power method; a few percent too small.

    One where the map is zero, as it is where nothing is free.
    """
    v, size = np.random.default_rng(0).normal(size=n), 1.0
    for _ in range(POWER_STEPS):
        v = apply(v / np.sqrt((v * v).sum()))
        size = float(np.sqrt((v * v).sum()))  # norm() rounds as its threads see fit, and bytes must not depend on them
        if size == 0.0:
            return 1.0
    return size


def dense_inverse(matrix: sparse.csr_array) -> np.ndarray:
    """The inverse (m, m) of a sparse matrix, by SuperLU: LAPACK's rounding depends on its threads."""
    return scipy.sparse.linalg.splu(sparse.csc_matrix(matrix)).solve(np.eye(matrix.shape[0]))


def coarse_space(matrix: sparse.csr_array, positions: np.ndarray, free: np.ndarray, inverse_diagonal, largest: float):
    """Prolongation (3 n, m) from the coarsest space of a stiffness matrix (3 n, 3 n) of points (n, 3).

    free (3 n,) bool; ``inverse_diagonal`` (3 n, 3 n) sparse, block diagonal, zero where not free; ``largest`` the
    largest eigenvalue of its product with the matrix.
    """
    if free.sum() <= SMALL:
        return sparse.csr_array(sparse.eye_array(len(free), format="csc")[:, free])
    n = len(positions)
    nodes = np.flatnonzero(free.reshape(n, 3).any(axis=1))
    blocks = matrix.tobsr((3, 3))
    graph = sparse.csr_array((np.ones(len(blocks.indices)), blocks.indices, blocks.indptr), shape=(n, n))
    aggregates, _ = standard_aggregation(sparse.csr_matrix(graph[nodes][:, nodes]))
    components = (3 * nodes[:, None] + np.arange(3)).ravel()
    motions = np.where(free[components, None], rigid_motions(positions[nodes]), 0.0)
    tentative, _ = fit_candidates(aggregates, motions)
    tentative = sparse.csr_array(tentative)
    tentative = tentative[:, np.flatnonzero(abs(tentative).sum(axis=0))]  # a motion that an aggregate cannot make
    place = sparse.csr_array(
        (np.ones(len(components)), (components, np.arange(len(components)))), (3 * n, len(components))
    )
    whole = place @ tentative
    return sparse.csr_array(whole - (4.0 / 3.0 / largest) * (inverse_diagonal @ (matrix @ whole)))
