"""The coarsest space of the multigrid preconditioner: rigid motions of aggregates of corners.

Aggregates are parts of the mesh's graph (Karypis and Kumar, SIAM J. Sci. Comput. 20, 1998; METIS). Their motions are
not smoothed, unlike those of Vanek, Mandel and Brezina (Computing 56, 1996). A corner thus belongs to one aggregate,
and the coarse matrix is cheap enough to be rebuilt for every state (see ``coarse_level``). A few aggregates suffice if
their matrix is that of the state: four presses to 2 mm on the BioTac's default mesh take 1,500 Krylov iterations with
32 aggregates, 1,466 with 64 and 1,651 with 16. A cube and a ring pressed 1.6 mm into the DIGIT's default mesh: 64 such
aggregates take 4.3 iterations a system (6 at 1.6 mm), 153 smoothed ones of the rest state took 6.5 (11 at 1.6 mm).
"""

from __future__ import annotations

import numpy as np
import pymetis
import scipy.sparse as sparse

AGGREGATES = 32
MOTIONS = 6  # of an aggregate
SMALL = AGGREGATES * MOTIONS  # with no more free unknowns than this, the coarsest space is the whole space
POWER_STEPS = 20
INDEPENDENT = 1e-6  # singular value over the largest: smaller ones depend on others, as in an aggregate of one corner


def rigid_motions(positions: np.ndarray) -> np.ndarray:
    """The six linearised rigid motions (3 n, 6) of points (n, 3)."""
    x = positions - positions.mean(axis=0)
    motions = np.zeros((len(x), 3, MOTIONS))
    for i in range(3):
        motions[:, i, i] = 1.0
        j, k = (i + 1) % 3, (i + 2) % 3
        motions[:, k, 3 + i], motions[:, j, 3 + i] = x[:, j], -x[:, k]
    return motions.reshape(-1, MOTIONS)


def largest_eigenvalue(apply, n: int) -> float:
    """Largest eigenvalue of a linear map (n,) -> (n,) with positive eigenvalues, by the power method.

    It is a few percent too small. It is 1 for a map that is zero because nothing is free.
    """
    v, size = np.random.default_rng(0).normal(size=n), 1.0
    for _ in range(POWER_STEPS):
        v = apply(v / np.sqrt((v * v).sum()))
        size = float(np.sqrt((v * v).sum()))  # unlike norm(), rounds alike with any number of threads
        if size == 0.0:
            return 1.0
    return size


def partition(graph: sparse.csr_array, count: int) -> np.ndarray:
    """Part (n,), 0 to count - 1, of each node of a symmetric graph (n, n)."""
    graph = sparse.csr_array(graph - sparse.diags_array(graph.diagonal()))
    graph.eliminate_zeros()
    _, parts = pymetis.part_graph(count, pymetis.CSRAdjacency(graph.indptr, graph.indices))
    return np.array(parts)


def coarse_space(graph: sparse.csr_array, positions: np.ndarray, free: np.ndarray) -> sparse.csr_array:
    """Prolongation (3 n, m) with orthonormal columns from the coarsest space of n points (n, 3).

    graph (n, n): neighbours of the points; free (3 n,) bool. No row has entries in more than `MOTIONS` columns.
    """
    if free.sum() <= SMALL:
        return sparse.csr_array(sparse.eye_array(len(free), format="csc")[:, free])
    nodes = np.flatnonzero(free.reshape(-1, 3).any(axis=1))
    parts = partition(sparse.csr_array(graph[nodes][:, nodes]), AGGREGATES)
    rows, columns, values, first = [], [], [], 0
    for part in np.unique(parts):
        members = nodes[parts == part]
        components = (3 * members[:, None] + np.arange(3)).ravel()
        is_free = free[components]
        components, motions = components[is_free], rigid_motions(positions[members])[is_free]
        basis, size, _ = np.linalg.svd(motions, full_matrices=False)
        basis = basis[:, size > INDEPENDENT * size[0]]
        rows.append(np.repeat(components, basis.shape[1]))
        columns.append(np.tile(first + np.arange(basis.shape[1]), len(components)))
        values.append(basis.ravel())
        first += basis.shape[1]
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    return sparse.csr_array(entries, shape=(len(free), first))
