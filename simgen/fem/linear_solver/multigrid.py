"""One multigrid cycle for the displacements: quadratic, linear, and rigid motions of aggregates of corners.

    level                          operator                 smoother
    quadratic displacements        matrix-free              Jacobi with 3 x 3 blocks
    linear displacements           assembled blocks         Chebyshev with 3 x 3 blocks
    rigid motions of aggregates    dense inverse            -

Quadratic to linear is p-multigrid (Ronquist and Patera, J. Sci. Comput. 2, 1987). The coarsest level is aggregation
(see ``aggregation`` and ``coarse_level``). The tangent changes under an indenter, so all levels are rebuilt for the
state.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
import warp as wp

from simgen.fem import batch_arrays, blocks
from simgen.fem.batch_arrays import Envs, SingleVectors
from simgen.fem.blocks import clear, load, store, zeros
from simgen.fem.chunks import chunks, load_chunk, store_chunk
from simgen.fem.elements.elasticity import Elasticity
from simgen.fem.linear_solver import rounded_blocks
from simgen.fem.linear_solver.aggregation import largest_eigenvalue
from simgen.fem.linear_solver.linear_multigrid import LinearMultigrid, chebyshev
from simgen.fem.linear_solver.pattern import corners_to_nodes
from simgen.fem.linear_solver.rounded_blocks import RoundedBlocks, invert_kernel, rounded_block
from simgen.fem.linear_solver.transfer import Transfer
from simgen.fem.precision import single

wp.set_module_options({"enable_backward": False})

QUADRATIC_SPREAD = 3.0  # largest over smallest eigenvalue that is smoothed


@wp.kernel
def start_kernel(inverse: RoundedBlocks, b: SingleVectors, step: single, active: Envs, x_out: SingleVectors):
    """The first smoothing step, from x = 0."""
    node, lane = wp.tid()
    env = active[lane]
    if env >= 0:
        store(x_out, node, env, step * (rounded_block(inverse, node, env) * load(b, node, env)))


@wp.kernel
def finish_kernel(
    inverse: RoundedBlocks, correction: SingleVectors, negative: SingleVectors, step: single, active: Envs,
    # outputs
    x_out: SingleVectors,
):
    """Add the correction of the lower levels, and a smoothing step for the residual that it leaves."""
    node, lane = wp.tid()
    env = active[lane]
    if env >= 0:
        change = load(correction, node, env) - step * (rounded_block(inverse, node, env) * load(negative, node, env))
        store(x_out, node, env, load(x_out, node, env) + change)


@wp.kernel
def negative_kernel(a: SingleVectors, active: Envs, negative_out: SingleVectors):
    c, lane = wp.tid()
    env = active[lane]
    if env >= 0:
        store_chunk(negative_out, c, env, -load_chunk(a, c, env))


class Multigrid:
    """Multigrid cycle for the displacements of quadratic elements, made at rest, with nothing in contact.

    ``add_tangent(v, out, reduced)`` as in `BlockTriangular`.
    """

    def __init__(self, elasticity: Elasticity, contacts: list, fixed, add_tangent):
        self.elasticity, self.contacts, self.active = elasticity, contacts, elasticity.active
        self._add_tangent = add_tangent
        self.fixed = fixed[: elasticity.n_displacements]
        device, n_env = elasticity.device, self.active.shape[0]
        n, n_nodes = len(fixed), elasticity.n_displacements // 3

        def vector(size):
            return wp.zeros((size, n_env), dtype=wp.float32, device=device)

        self._blocks = zeros(n_nodes, n_env, device)
        self._inverse = rounded_blocks.zeros(n_nodes, n_env, device)
        self._nodes = wp.array(np.arange(n_nodes), dtype=wp.int32, device=device)
        self._negative = vector(n)  # minus the residual
        self._correction = vector(n)  # of the lower levels: displacements only
        self._linear_b, self._linear_x = vector(3 * elasticity.n_corners), vector(3 * elasticity.n_corners)
        elasticity.linearize(wp.zeros((n, n_env), dtype=wp.float64, device=device))
        self.linear = LinearMultigrid(elasticity, contacts, fixed)
        self.transfer = Transfer(self._embedding(), self.active)
        self._invert_diagonal()
        self._step = 1.0
        [(_, self._step)] = chebyshev(self._largest_eigenvalue(), 1, QUADRATIC_SPREAD)

    def _embedding(self) -> sparse.csr_array:
        """Linear displacements at all nodes, (3 nodes, 3 corners), where both node and corner are free."""
        free, n_corners = self.fixed.numpy() == 0, self.elasticity.n_corners
        nodal = corners_to_nodes(self.elasticity.host_tetrahedra, len(free) // 3, n_corners)
        fine, coarse = (sparse.diags_array(f.astype(float)) for f in (free, free[: 3 * n_corners]))
        matrix = sparse.csr_array(fine @ sparse.kron(nodal, sparse.eye_array(3)) @ coarse)
        matrix.eliminate_zeros()
        return matrix

    def _largest_eigenvalue(self) -> float:
        """Largest eigenvalue of the first environment, at rest as all are."""
        n_u = self.elasticity.n_displacements
        v, out = (wp.zeros_like(self._negative) for _ in range(2))

        def apply(u):
            wp.copy(v[:n_u, 0], wp.array(u, dtype=wp.float32, device=v.device))
            self._negative.zero_()
            self._add_tangent(v, self._negative, reduced=True)
            self._launch(start_kernel, [self._inverse, self._negative, self._step, self.active], [out])
            return out[:n_u, 0].contiguous().numpy()

        before = self.active.chosen
        self.active.choose(np.arange(len(before)) == 0)
        found = largest_eigenvalue(apply, n_u)
        self.active.choose(before)
        return found

    def _invert_diagonal(self):
        clear(self._blocks, self.active)
        for term in (self.elasticity, *self.contacts):
            term.diagonal(self._blocks)
        self._launch(invert_kernel, [self._blocks, self._nodes, self.fixed, self.active], [self._inverse])

    def move(self, sources: np.ndarray, targets: np.ndarray):
        """Copy the cycles of the environments numbered ``sources`` (k,) to those numbered ``targets`` (k,)."""
        blocks.move([self._inverse, *self.linear.matrices], self.active, sources, targets)

    def rebuild(self):
        """Rebuild all levels from the last linearisation of the active environments."""
        self._invert_diagonal()
        self.linear.rebuild()

    def _launch(self, kernel, inputs, outputs):
        batch_arrays.launch(kernel, len(self._nodes), inputs, outputs)

    def apply(self, b, x_out):
        """Set the displacements in x to about K^-1 (b - B^T p), where p are the pressures in x."""
        inverse, step = self._inverse, self._step
        self._launch(start_kernel, [inverse, b, step, self.active], [x_out])  # the residual contains p, this does not
        batch_arrays.launch(negative_kernel, chunks(b.shape[0]), [b, self.active], [self._negative])
        self._add_tangent(x_out, self._negative, reduced=True)
        self.transfer.restrict(self._negative, self._linear_b, -1.0)
        self.linear.apply(self._linear_b, self._linear_x)
        self.transfer.prolong(self._linear_x, self._correction)
        self._add_tangent(self._correction, self._negative, reduced=True)
        self._launch(finish_kernel, [inverse, self._correction, self._negative, step, self.active], [x_out])
