"""Block-triangular preconditioner of the mixed system, with a sparse factor of the current displacement block.

    [ A  B^T ]          [ A  B^T ]
    [ B  -C  ]    ~     [ 0  -S  ]      S = (1 / (mu + gamma) + 1 / (lam - gamma)) x lumped pressure mass

(Murphy, Golub and Wathen, SIAM J. Sci. Comput. 21, 2000, for the form). A holds elasticity and contact of one
environment and is factored on the host (``factor.py``); GMRES around it works in double precision.
A liquid borders A by one dense row and column g, which are eliminated: [A g; g^T 0] needs one more solve, A^-1 g, for
each factor, and one inner product for each use.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
import warp as wp

from .factor import FACTORS, Singular, elimination_order
from .material import mat33


class BlockPattern:
    """Sparsity of the 3 x 3 displacement blocks: where element and face matrices add, and which entries are free.

    ``held`` (node, 3) marks the displacement components that are zero.
    """

    def __init__(self, n_nodes: int, tetrahedra: np.ndarray, faces: list[np.ndarray], held: np.ndarray, device):
        pairs = tetrahedra[:, :, None].astype(np.int64) * n_nodes + tetrahedra[:, None, :]
        unique, inverse = np.unique(pairs, return_inverse=True)
        self.n_blocks = len(unique)
        self.tet_index = wp.array(inverse.reshape(pairs.shape).astype(np.int32), dtype=wp.int32, device=device)
        self.face_index = []
        for f in faces:
            index = np.searchsorted(unique, f[:, :, None].astype(np.int64) * n_nodes + f[:, None, :])
            self.face_index.append(wp.array(index.astype(np.int32), dtype=wp.int32, device=device))
        rows, columns = np.divmod(unique, n_nodes)
        graph = sparse.csr_array((np.ones(len(unique)), (rows, columns)), shape=(n_nodes, n_nodes))
        unknowns = (3 * elimination_order(graph)[:, None] + np.arange(3)).ravel()
        self.free = unknowns[~held.ravel()[unknowns]]
        # The scalar matrix of the free unknowns as CSC, and which block entry feeds each of its values.
        entry = np.arange(9 * self.n_blocks).reshape(-1, 3, 3)
        row = np.broadcast_to(3 * rows[:, None, None] + np.arange(3)[None, :, None], entry.shape).ravel()
        column = np.broadcast_to(3 * columns[:, None, None] + np.arange(3)[None, None, :], entry.shape).ravel()
        numbered = sparse.coo_matrix((entry.ravel() + 1.0, (row, column)), shape=(3 * n_nodes, 3 * n_nodes)).tocsc()
        self._pattern = numbered[self.free][:, self.free].tocsc()
        self._pattern.sort_indices()
        self._entries = self._pattern.data.astype(np.int64) - 1

    def matrix(self, values: np.ndarray) -> sparse.csc_matrix:
        """The free unknowns' matrix of one environment's blocks (n_blocks, 3, 3), in elimination order."""
        data = values.ravel()[self._entries]
        return sparse.csc_matrix((data, self._pattern.indices, self._pattern.indptr), shape=self._pattern.shape)


class BlockTriangular:
    """Applies the preconditioner; ``update`` factors the current state of the environments that ask for it."""

    def __init__(self, elasticity, contacts, cavity, pattern: BlockPattern, n_env: int, factorization: str):
        self.elasticity, self.cavity, self.pattern = elasticity, cavity, pattern
        self._factor = FACTORS[factorization]
        self._surface_terms = contacts if cavity is None else [*contacts, cavity]
        material = elasticity.material
        if elasticity.n_pressures:
            compliance = 1.0 / (material.mu + material.gamma) + material.pressure_compliance
            self.schur = (compliance * elasticity.pressure_mass)[:, None]
        self._blocks = wp.zeros((pattern.n_blocks, n_env), dtype=mat33, device=elasticity.device)
        n = elasticity.n_displacements + elasticity.n_pressures + (cavity is not None)
        self._z = wp.zeros((n, n_env), dtype=wp.float64, device=elasticity.device)
        self._pressure_forces = wp.zeros_like(self._z)
        self.forget()

    def forget(self):
        """Drop the factors of the last presses: a press must not depend on those before it."""
        self.factors = [None] * self._blocks.shape[1]
        self._borders = [None] * self._blocks.shape[1]  # g and A^-1 g of the free unknowns

    def update(self, environments: np.ndarray) -> np.ndarray:
        """Factor the displacement blocks of the last linearisation for the given environments.

        Returns the environments whose matrix is singular; they have no factor then.
        """
        self._blocks.zero_()
        self.elasticity.blocks(self.pattern.tet_index, self._blocks)
        for term, index in zip(self._surface_terms, self.pattern.face_index, strict=True):
            term.blocks(index, self._blocks)
        values = self._blocks.numpy()
        singular = []
        for env in environments:
            self.factors[env] = None  # before the next one is made: together they may not fit into memory
            try:
                self.factors[env] = self._factor(self.pattern.matrix(values[:, env]))
            except Singular:
                singular.append(env)
                continue
            if self.cavity is not None:
                gradient = self.cavity.gradient.numpy()[self.pattern.free, env]
                self._borders[env] = gradient, self.factors[env].solve(gradient)
        return np.array(singular, dtype=int)

    def apply(self, r, z_out):
        """z = M^-1 r."""
        n_u = self.elasticity.n_displacements
        residual = r.numpy()
        z = np.zeros(residual.shape)
        load = residual[:n_u]
        if n_p := self.elasticity.n_pressures:
            z[n_u : n_u + n_p] = -residual[n_u : n_u + n_p] / self.schur
            self._z.assign(z)
            self._pressure_forces.zero_()
            self.elasticity.pressure_action(self._z, self._pressure_forces)
            load = load - self._pressure_forces.numpy()[:n_u]
        for env, factor in enumerate(self.factors):
            if factor is not None:
                free = self.pattern.free
                u = factor.solve(load[free, env])
                if self.cavity is not None:
                    gradient, response = self._borders[env]
                    pressure = (gradient @ u - residual[self.cavity.row, env]) / (gradient @ response)
                    z[self.cavity.row, env] = pressure
                    u = u - pressure * response
                z[free, env] = u
        z_out.assign(z)
