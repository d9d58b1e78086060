"""One cycle of multigrid for the displacements: quadratic, linear, and rigid motions of aggregates of corners.

    level                     operator              smoother                         what it keeps to
    quadratic displacements   matrix-free           Jacobi with 3 x 3 blocks         the current state
    linear ones (corners)     blocks, assembled     Chebyshev, the same blocks       the current state
    aggregates                dense inverse         -                                the current state

Quadratic to linear is p-multigrid (Ronquist and Patera, J. Sci. Comput. 2, 1987), below it is aggregation (see
``aggregation`` and ``coarse_level``). The tangent changes under an indenter, and all levels follow it.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
import warp as wp

from simgen.fem import batch_arrays
from simgen.fem.blocks import Blocks, block, clear, invert_kernel, load, store, zeros
from simgen.fem.elements.elasticity import Elasticity
from simgen.fem.linear_solver.aggregation import largest_eigenvalue
from simgen.fem.linear_solver.linear_multigrid import CornerCycle, chebyshev
from simgen.fem.linear_solver.pattern import corners_to_nodes
from simgen.fem.linear_solver.transfer import Transfer
from simgen.fem.material.neo_hookean import single
from simgen.fem.sections import chunks, store_terms, terms

wp.set_module_options({"enable_backward": False})

QUADRATIC_SPREAD = 3.0  # largest over smallest eigenvalue that smoothing acts on


@wp.kernel
def smooth_kernel(
    inverse: Blocks,
    residual: wp.array2d(dtype=wp.float32),
    step: single,
    active: wp.array(dtype=wp.int32),
    # outputs
    x_out: wp.array2d(dtype=wp.float32),
):
    node, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    change = step * (block(inverse, node, env) * load(residual, node, env))
    store(x_out, node, env, load(x_out, node, env) + change)


@wp.kernel
def negative_kernel(
    a: wp.array2d(dtype=wp.float32),
    active: wp.array(dtype=wp.int32),
    # outputs
    negative_out: wp.array2d(dtype=wp.float32),
):
    c, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    store_terms(negative_out, c, env, -terms(a, c, env))


class Multigrid:
    """The displacements of quadratic elements. ``add_tangent(v, out, rough)`` is the whole system's, held rows zero.

    Made at rest, with nothing in contact.
    """

    def __init__(self, elasticity: Elasticity, contacts: list, fixed, add_tangent):
        self.elasticity, self.contacts, self.active = elasticity, contacts, elasticity.active
        self._add_tangent = add_tangent
        self.fixed = fixed[: elasticity.n_displacements]
        device, n_env = elasticity.device, self.active.shape[0]
        n, n_nodes = len(fixed), elasticity.n_displacements // 3

        def vector(size):
            return wp.zeros((size, n_env), dtype=wp.float32, device=device)

        self._blocks, self._inverse = (zeros(n_nodes, n_env, device) for _ in range(2))
        self._nodes = wp.array(np.arange(n_nodes), dtype=wp.int32, device=device)
        self._negative = vector(n)  # residual, with the opposite sign
        self._corner_b, self._corner_x = vector(3 * elasticity.n_corners), vector(3 * elasticity.n_corners)
        elasticity.linearize(wp.zeros((n, n_env), dtype=wp.float64, device=device))
        self.corners = CornerCycle(elasticity, contacts, fixed)
        self.transfer = Transfer(self._embedding(), self.active)
        self._invert_diagonal()
        self._step = 1.0
        [(_, self._step)] = chebyshev(self._largest_eigenvalue(), 1, QUADRATIC_SPREAD)

    def _embedding(self) -> sparse.csr_array:
        """Linear displacements at all nodes, (3 nodes, 3 corners), of what is free on both sides."""
        free, n_corners = self.fixed.numpy() == 0, self.elasticity.n_corners
        nodal = corners_to_nodes(self.elasticity.host_tetrahedra, len(free) // 3, n_corners)
        fine, coarse = (sparse.diags_array(f.astype(float)) for f in (free, free[: 3 * n_corners]))
        matrix = sparse.csr_array(fine @ sparse.kron(nodal, sparse.eye_array(3)) @ coarse)
        matrix.eliminate_zeros()
        return matrix

    def _largest_eigenvalue(self) -> float:
        """Of the first environment, at rest as all are: what the others have stays on the device."""
        n_u = self.elasticity.n_displacements
        v, out = (wp.zeros_like(self._negative) for _ in range(2))

        def apply(u):
            wp.copy(v[:n_u, 0], wp.array(u, dtype=wp.float32, device=v.device))
            self._negative.zero_()
            self._add_tangent(v, self._negative, rough=True)
            out.zero_()
            self._smooth(self._negative, out)
            return out[:n_u, 0].contiguous().numpy()

        return largest_eigenvalue(apply, n_u)

    def _invert_diagonal(self):
        clear(self._blocks, self.active)
        for term in (self.elasticity, *self.contacts):
            term.diagonal(self._blocks)
        self._launch(invert_kernel, [self._blocks, self._nodes, self.fixed, self.active], [self._inverse])

    def update(self):
        """Follow the last linearisation in the active environments."""
        self._invert_diagonal()
        self.corners.update()

    def _launch(self, kernel, inputs, outputs):
        batch_arrays.launch(kernel, len(self._nodes), inputs, outputs)

    def _smooth(self, residual, x_out, sign: float = 1.0):
        self._launch(smooth_kernel, [self._inverse, residual, sign * self._step, self.active], [x_out])

    def _remainder(self, b, x):
        batch_arrays.launch(negative_kernel, chunks(b.shape[0]), [b, self.active], [self._negative])
        self._add_tangent(x, self._negative, rough=True)

    def apply(self, b, x_out):
        """Change the displacements in x, which are zero, to about K^-1 (b - B^T p), p being the pressures in x."""
        self._smooth(b, x_out)  # knows nothing of p; what it leaves out remains
        self._remainder(b, x_out)
        self.transfer.restrict(self._negative, self._corner_b, -1.0)
        self.corners.apply(self._corner_b, self._corner_x)
        self.transfer.prolong(self._corner_x, x_out)
        self._remainder(b, x_out)
        self._smooth(self._negative, x_out, -1.0)
