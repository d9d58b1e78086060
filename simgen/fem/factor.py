"""Sparse factors of the displacement block on the host: SuperLU of scipy, or MKL's PARDISO where it is installed.

Both eliminate in an order found by nested dissection (Karypis and Kumar, SIAM J. Sci. Comput. 20, 1998; METIS) on the
graph of the nodes. A factor has ``solve(b)``, float64 in and out.
"""

from __future__ import annotations

import os

import numpy as np
import pymetis
import scipy.sparse as sparse
import scipy.sparse.linalg

from ..errors import InputError


class Singular(ValueError):
    """The matrix has no factor."""


class SuperLU:
    """Single precision, one thread: what every machine has."""

    def __init__(self, matrix: sparse.csc_matrix):
        try:
            self._factor = scipy.sparse.linalg.splu(
                matrix.astype(np.float32),
                permc_spec="NATURAL",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
        except RuntimeError as error:  # "Factor is exactly singular"
            raise Singular(str(error)) from error

    def solve(self, b: np.ndarray) -> np.ndarray:
        return self._factor.solve(b.astype(np.float32)).astype(float)


class Pardiso:
    """Double precision, supernodal: several times faster from some 50,000 unknowns on (pip install simgen[pardiso])."""

    def __init__(self, matrix: sparse.csc_matrix):
        os.environ.setdefault("MKL_NUM_THREADS", "1")  # a worker has one core; and the same bytes whatever the machine
        try:
            from pypardiso import PyPardisoSolver
        except ImportError as error:
            raise InputError(
                "solver.factorization = 'pardiso': pypardiso is not installed here, allowed: superlu"
            ) from error
        self._matrix, self._solver = matrix, PyPardisoSolver(mtype=11)
        self._solver.factorize(matrix)

    def solve(self, b: np.ndarray) -> np.ndarray:
        return self._solver.solve(self._matrix, b)

    def __del__(self):
        if hasattr(self, "_solver"):
            self._solver.free_memory(everything=True)


FACTORS = {"superlu": SuperLU, "pardiso": Pardiso}


def elimination_order(graph: sparse.csr_array) -> np.ndarray:
    """Nested dissection order (n,) of a symmetric graph (n, n): old index of each new one."""
    graph = sparse.csr_array(graph - sparse.diags_array(graph.diagonal()))
    graph.eliminate_zeros()
    order, _ = pymetis.nested_dissection(pymetis.CSRAdjacency(graph.indptr, graph.indices))
    return np.array(order)
