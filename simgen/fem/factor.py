"""Sparse factors of linear tetrahedra's tangent, on the host: they lock, and locked systems need direct solvers."""

from __future__ import annotations

import numpy as np
import scipy.sparse.linalg
import warp as wp

from .corners import CornerPattern
from .material import mat33

REFACTOR_ABOVE = 10  # Krylov iterations above which a factor is made anew


class CornerFactor:
    """SuperLU factors of the displacement blocks of elements without pressures, one for each environment."""

    def __init__(self, elasticity, contacts: list, held):
        self.elasticity, self.contacts = elasticity, contacts
        faces = [contact.host_faces for contact in contacts]
        self.pattern = CornerPattern(elasticity.n_corners, elasticity.host_tetrahedra, faces, elasticity.device)
        self.free = np.flatnonzero(held.numpy()[: elasticity.n_displacements] == 0)
        self._blocks = wp.zeros(
            (self.pattern.n_blocks, elasticity.active.shape[0]), dtype=mat33, device=elasticity.device
        )
        self.forget()

    def forget(self):
        """Drop the factors of the last presses: a press must not depend on those before it."""
        self.factors = [None] * self._blocks.shape[1]

    def update(self, environments: np.ndarray, iterations: np.ndarray) -> np.ndarray:
        """Follow the last linearisation where the last solve took many iterations; returns singular environments."""
        wanted = [e for e in environments if self.factors[e] is None or iterations[e] > REFACTOR_ABOVE]
        if not wanted:
            return np.zeros(0, dtype=int)
        self._blocks.zero_()
        self.elasticity.corner_blocks(self.pattern.tet_index, self._blocks)
        for contact, index in zip(self.contacts, self.pattern.face_index, strict=True):
            contact.corner_blocks(index, self._blocks)
        values, singular = self._blocks.numpy(), []
        for env in wanted:
            self.factors[env] = None  # before the next one is made: together they may not fit into memory
            matrix = self.pattern.matrix(values[:, env])[self.free][:, self.free].tocsc()
            try:
                self.factors[env] = scipy.sparse.linalg.splu(
                    matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
                )
            except RuntimeError:  # "Factor is exactly singular"
                singular.append(env)
        return np.array(singular, dtype=int)

    def apply(self, b, x_out):
        """x = K^-1 b with the K of the factors."""
        load, x = b.numpy(), x_out.numpy().copy()
        for env, factor in enumerate(self.factors):
            if factor is not None:
                x[self.free, env] = factor.solve(np.ascontiguousarray(load[self.free, env]))
        x_out.assign(x)
