"""Sparse factors of the displacement block on the host, for cases where multigrid fails.

These are linear tetrahedra, which lock; slivers; and bodies that deform as a whole far beyond their rest state. Factors
are SciPy's SuperLU in single precision, ordered by nested dissection of the graph of the nodes (Karypis and Kumar, SIAM
J. Sci. Comput. 20, 1998; METIS).
"""

from __future__ import annotations

import numpy as np
import pymetis
import scipy.sparse as sparse
import scipy.sparse.linalg
import warp as wp

from simgen.fem import blocks
from simgen.fem.linear_solver.pattern import BlockPattern

REFACTOR_ABOVE = 10  # Krylov iterations of the last solve above which the matrix is factored again


def elimination_order(graph: sparse.csr_array) -> np.ndarray:
    """Nested dissection order (n,) of a symmetric graph (n, n): old index of each new one."""
    graph = sparse.csr_array(graph - sparse.diags_array(graph.diagonal()))
    graph.eliminate_zeros()
    order, _ = pymetis.nested_dissection(pymetis.CSRAdjacency(graph.indptr, graph.indices))
    return np.array(order)


class SparseFactor:
    """Factor of the displacement block for each environment, at the state of its last factorisation.

    ``fixed`` (unknowns,) int32 on the device; ``add_tangent(v, out, reduced)`` as in `BlockTriangular`.
    """

    def __init__(self, elasticity, surface_terms: list, fixed, add_tangent):
        self.elasticity, self.surface_terms, self._add_tangent = elasticity, surface_terms, add_tangent
        n, n_env, device = elasticity.n_displacements // 3, elasticity.active.shape[0], elasticity.device
        faces = [term.host_faces for term in surface_terms]
        self.pattern = BlockPattern(n, elasticity.host_tetrahedra, faces, device)
        self._blocks = blocks.zeros(self.pattern.n_blocks, n_env, device)
        unknowns = (3 * elimination_order(self.pattern.graph())[:, None] + np.arange(3)).ravel()
        self.free = unknowns[fixed.numpy()[unknowns] == 0]
        self._action = wp.zeros((len(fixed), n_env), dtype=wp.float32, device=device)
        self.factors, self._solved = [None] * n_env, np.zeros(0, dtype=int)

    def forget(self, environments: np.ndarray):
        """Drop the factors of the environments (env,) bool."""
        for env in np.flatnonzero(environments):
            self.factors[env] = None

    def refactor(self, environments: np.ndarray, iterations: np.ndarray) -> np.ndarray:
        """Factor the last linearisation where there is no factor, or where the last solve took many iterations (env,).

        environments : their numbers. Returns the numbers of those whose matrix is singular; they have no factor.
        """
        self._solved = environments
        wanted = [e for e in environments if self.factors[e] is None or iterations[e] > REFACTOR_ABOVE]
        if not wanted:
            return np.zeros(0, dtype=int)
        self._blocks.zero_()
        self.elasticity.blocks(self.pattern.tet_index, self._blocks, linear=False)
        for term, index in zip(self.surface_terms, self.pattern.face_index, strict=True):
            term.blocks(index, self._blocks, linear=False)
        singular = []
        for env in wanted:
            self.factors[env] = None  # first: two may not fit into memory
            matrix = self.pattern.matrix(blocks.of_environment(self._blocks, env))[self.free][:, self.free].tocsc()
            try:
                self.factors[env] = scipy.sparse.linalg.splu(
                    matrix, permc_spec="NATURAL", diag_pivot_thresh=0.0,
                    options={"SymmetricMode": True},
                )  # fmt: skip
            except RuntimeError:  # "Factor is exactly singular"
                singular.append(env)
        return np.array(singular, dtype=int)

    def apply(self, b, x_out):
        """Set the displacements in x, which are zero, to A^-1 (b - B^T p), where p are the pressures in x."""
        self._action.zero_()
        self._add_tangent(x_out, self._action, reduced=False)
        load, x = b.numpy() - self._action.numpy(), x_out.numpy().copy()
        for env in self._solved:
            if self.factors[env] is not None:
                x[self.free, env] = self.factors[env].solve(load[self.free, env])
        x_out.assign(x)
