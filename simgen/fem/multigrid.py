"""One cycle of multigrid for the displacements: quadratic, linear, and rigid motions of aggregates of corners.

    level                     operator              smoother                         what it keeps to
    quadratic displacements   matrix-free           Jacobi with 3 x 3 blocks         the current state
    linear ones (corners)     blocks, assembled     Chebyshev, the same blocks       the current state
    aggregates                dense inverse         -                                the state of rest

Quadratic to linear is p-multigrid (Ronquist and Patera, J. Sci. Comput. 2, 1987), below it is smoothed aggregation
(see ``aggregation``). The tangent changes under an indenter, and the upper two levels follow it. What is left to the
lowest changes little: with the state of rest there, a press 2 mm deep takes one Krylov iteration more. It is made once
for a sensor, shared by all presses, and so large only that a dense inverse of it costs nothing.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
import warp as wp

from . import columns
from .aggregation import coarse_space, dense_inverse, largest_eigenvalue
from .material import mat33f, single, vec3f
from .operator import Elasticity
from .pattern import BlockPattern, corners_to_nodes

wp.set_module_options({"enable_backward": False})

QUADRATIC_SPREAD = 3.0  # largest over smallest eigenvalue that smoothing acts on
CORNER_SPREAD, CORNER_STEPS = 10.0, 3
MARGIN = 1.15  # on the largest eigenvalue at rest: contact and large strains raise it a little


def chebyshev(largest: float, steps: int, spread: float) -> list[tuple[float, float]]:
    """Coefficients (c_d, c_r) of steps d = c_d d + c_r D^-1 r, x += d that damp eigenvalues up to ``largest``.

    Saad, *Iterative Methods for Sparse Linear Systems*, 2nd ed., algorithm 12.1.
    """
    high, low = MARGIN * largest, MARGIN * largest / spread
    middle, half = 0.5 * (high + low), 0.5 * (high - low)
    rho, coefficients = half / middle, [(0.0, 1.0 / middle)]
    for _ in range(steps - 1):
        following = 1.0 / (2.0 * middle / half - rho)
        coefficients.append((following * rho, 2.0 * following / half))
        rho = following
    return coefficients


@wp.kernel
def invert_kernel(
    blocks: wp.array2d(dtype=mat33f),
    diagonal: wp.array(dtype=wp.int32),
    held: wp.array(dtype=wp.int32),
    active: wp.array(dtype=wp.int32),
    # outputs
    inverse_out: wp.array2d(dtype=mat33f),
):
    """Invert the diagonal blocks; rows and columns of what is held become zero."""
    node, env = wp.tid()
    if active[env] == 0:
        return
    K = blocks[diagonal[node], env]
    for i in range(3):
        if held[3 * node + i] == 1:
            for j in range(3):
                K[i, j] = 0.0
                K[j, i] = 0.0
            K[i, i] = 1.0
    K = wp.inverse(K)
    for i in range(3):
        if held[3 * node + i] == 1:
            K[i, i] = 0.0
    inverse_out[node, env] = K


@wp.func
def load(x: wp.array2d(dtype=wp.float32), node: wp.int32, env: wp.int32) -> vec3f:
    return vec3f(x[3 * node, env], x[3 * node + 1, env], x[3 * node + 2, env])


@wp.kernel
def smooth_kernel(
    inverse: wp.array2d(dtype=mat33f),
    residual: wp.array2d(dtype=wp.float32),
    keep: single,
    step: single,
    active: wp.array(dtype=wp.int32),
    # outputs
    direction_out: wp.array2d(dtype=wp.float32),
    x_out: wp.array2d(dtype=wp.float32),
):
    node, env = wp.tid()
    if active[env] == 0:
        return
    d = step * (inverse[node, env] * load(residual, node, env))
    if keep != 0.0:
        d += keep * load(direction_out, node, env)
    for i in range(3):
        direction_out[3 * node + i, env] = d[i]
        x_out[3 * node + i, env] = x_out[3 * node + i, env] + d[i]


@wp.kernel
def difference_kernel(
    a: wp.array2d(dtype=wp.float32),
    b: wp.array2d(dtype=wp.float32),
    # outputs
    difference_out: wp.array2d(dtype=wp.float32),
):
    i, env = wp.tid()
    difference_out[i, env] = a[i, env] - b[i, env]


@wp.kernel
def blocks_residual_kernel(
    row_starts: wp.array(dtype=wp.int32),
    columns: wp.array(dtype=wp.int32),
    blocks: wp.array2d(dtype=mat33f),
    x: wp.array2d(dtype=wp.float32),
    b: wp.array2d(dtype=wp.float32),
    active: wp.array(dtype=wp.int32),
    # outputs
    residual_out: wp.array2d(dtype=wp.float32),
):
    row, env = wp.tid()
    if active[env] == 0:
        return
    r = load(b, row, env)
    for k in range(row_starts[row], row_starts[row + 1]):
        r -= blocks[k, env] * load(x, columns[k], env)
    for i in range(3):
        residual_out[3 * row + i, env] = r[i]


@wp.kernel
def add_sparse_kernel(
    row_starts: wp.array(dtype=wp.int32),
    columns: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.float32),
    x: wp.array2d(dtype=wp.float32),
    # outputs
    y_out: wp.array2d(dtype=wp.float32),
):
    row, env = wp.tid()
    total = single(0.0)
    for k in range(row_starts[row], row_starts[row + 1]):
        total += values[k] * x[columns[k], env]
    y_out[row, env] = y_out[row, env] + total


@wp.kernel
def dense_kernel(
    matrix: wp.array2d(dtype=wp.float32),
    x: wp.array2d(dtype=wp.float32),
    # outputs
    y_out: wp.array2d(dtype=wp.float32),
):
    """Four sums at once: one alone waits for each addition."""
    row, env = wp.tid()
    n = matrix.shape[1]
    sums = wp.vec4f()
    for k in range(n // 4):
        i = 4 * k
        sums += wp.vec4f(
            matrix[row, i] * x[i, env],
            matrix[row, i + 1] * x[i + 1, env],
            matrix[row, i + 2] * x[i + 2, env],
            matrix[row, i + 3] * x[i + 3, env],
        )
    total = (sums[0] + sums[1]) + (sums[2] + sums[3])
    for i in range(n - n % 4, n):
        total += matrix[row, i] * x[i, env]
    y_out[row, env] = total


class Transfer:
    """A sparse matrix that is the same for all environments, and its transpose."""

    def __init__(self, matrix: sparse.csr_array, device):
        self.shape = matrix.shape
        self._there, self._back = (self._on_device(m, device) for m in (matrix, sparse.csr_array(matrix.T)))

    @staticmethod
    def _on_device(matrix, device):
        indices = [wp.array(a.astype(np.int32), dtype=wp.int32, device=device) for a in (matrix.indptr, matrix.indices)]
        return [*indices, wp.array(matrix.data, dtype=wp.float32, device=device)]

    def prolong(self, x, y_out):
        """y += M x."""
        dim = (self.shape[0], x.shape[1])
        wp.launch(add_sparse_kernel, dim=dim, inputs=[*self._there, x], outputs=[y_out], device=x.device)

    def restrict(self, x, y_out):
        """y = M^T x."""
        y_out.zero_()
        dim = (self.shape[1], x.shape[1])
        wp.launch(add_sparse_kernel, dim=dim, inputs=[*self._back, x], outputs=[y_out], device=x.device)


class CornerCycle:
    """Linear displacements: a V-cycle with the aggregates below, on blocks that are assembled for every state."""

    def __init__(self, elasticity: Elasticity, contacts: list, held):
        self.elasticity, self.contacts, self.active = elasticity, contacts, elasticity.active
        n, n_env, device = elasticity.n_corners, self.active.shape[0], elasticity.device
        faces = [contact.host_faces[:, :3] for contact in contacts]
        self.pattern = BlockPattern(n, elasticity.host_tetrahedra[:, :4], faces, device)
        self.held = held[: 3 * n]
        self._blocks = wp.zeros((self.pattern.n_blocks, n_env), dtype=mat33f, device=device)
        self._inverse = wp.zeros((n, n_env), dtype=mat33f, device=device)
        self._residual, self._direction = (wp.zeros((3 * n, n_env), dtype=wp.float32, device=device) for _ in range(2))
        diagonal = np.repeat(np.arange(n), np.diff(self.pattern.host_row_starts)) == self.pattern.host_columns
        self._diagonal = wp.array(np.flatnonzero(diagonal), dtype=wp.int32, device=device)
        self.update()
        matrix = self.pattern.matrix(self._blocks.numpy()[:, 0])
        inverse = self._inverse.numpy()[:, 0]
        inverse = sparse.csr_array(sparse.bsr_array((inverse, np.arange(n), np.arange(n + 1)), shape=matrix.shape))
        largest = largest_eigenvalue(lambda v: inverse @ (matrix @ v), 3 * n)
        self._smoothing = chebyshev(largest, CORNER_STEPS, CORNER_SPREAD)
        space = coarse_space(matrix, elasticity.host_nodes[:n], self.held.numpy() == 0, inverse, largest)
        self.space = Transfer(space, device)
        coarse = dense_inverse(space.T @ matrix @ space)
        self._coarse_inverse = wp.array(coarse, dtype=wp.float32, device=device)
        self._coarse, self._coarse_x = (wp.zeros((len(coarse), n_env), dtype=wp.float32, device=device) for _ in "rx")

    def update(self):
        """Assemble the blocks of the last linearisation of the active environments."""
        columns.clear(self.active, self._blocks)
        self.elasticity.blocks(self.pattern.tet_index, self._blocks, linear=True)
        for contact, index in zip(self.contacts, self.pattern.face_index, strict=True):
            contact.blocks(index, self._blocks, linear=True)
        self._launch(invert_kernel, [self._blocks, self._diagonal, self.held, self.active], [self._inverse])

    def _launch(self, kernel, inputs, outputs):
        wp.launch(kernel, dim=self._inverse.shape, inputs=inputs, outputs=outputs, device=self._inverse.device)

    def _smooth(self, b, x_out):
        for keep, step in self._smoothing:
            self._remainder(b, x_out)
            inputs = [self._inverse, self._residual, keep, step, self.active]
            self._launch(smooth_kernel, inputs, [self._direction, x_out])

    def _remainder(self, b, x):
        inputs = [self.pattern.row_starts, self.pattern.columns, self._blocks, x, b, self.active]
        self._launch(blocks_residual_kernel, inputs, [self._residual])

    def apply(self, b, x_out):
        """x = about K^-1 b."""
        x_out.zero_()
        self._smooth(b, x_out)
        self._remainder(b, x_out)
        self.space.restrict(self._residual, self._coarse)
        inputs = [self._coarse_inverse, self._coarse]
        wp.launch(dense_kernel, dim=self._coarse.shape, inputs=inputs, outputs=[self._coarse_x], device=b.device)
        self.space.prolong(self._coarse_x, x_out)
        self._smooth(b, x_out)


class Multigrid:
    """The displacements of quadratic elements. ``tangent(v, out)`` is the whole system's, held rows zero.

    Made at rest, with nothing in contact.
    """

    def __init__(self, elasticity: Elasticity, contacts: list, held, tangent):
        self.elasticity, self.contacts, self.active, self._tangent = elasticity, contacts, elasticity.active, tangent
        self.held = held[: elasticity.n_displacements]
        device, n_env = elasticity.device, self.active.shape[0]
        n, n_nodes = len(held), elasticity.n_displacements // 3

        def vector(size):
            return wp.zeros((size, n_env), dtype=wp.float32, device=device)

        self._blocks, self._inverse = (wp.zeros((n_nodes, n_env), dtype=mat33f, device=device) for _ in range(2))
        self._nodes = wp.array(np.arange(n_nodes), dtype=wp.int32, device=device)
        self._residual, self._action, self._direction = vector(n), vector(n), vector(n)
        self._corner_b, self._corner_x = vector(3 * elasticity.n_corners), vector(3 * elasticity.n_corners)
        elasticity.linearize(wp.zeros((n, n_env), dtype=wp.float64, device=device))
        self.corners = CornerCycle(elasticity, contacts, held)
        self.transfer = Transfer(self._embedding(), device)
        self._invert_diagonal()
        self._smoothing = (0.0, 1.0)
        [self._smoothing] = chebyshev(self._largest_eigenvalue(), 1, QUADRATIC_SPREAD)

    def _embedding(self) -> sparse.csr_array:
        """Linear displacements at all nodes, (3 nodes, 3 corners), of what is free on both sides."""
        free, n_corners = self.held.numpy() == 0, self.elasticity.n_corners
        nodal = corners_to_nodes(self.elasticity.host_tetrahedra, len(free) // 3, n_corners)
        fine, coarse = (sparse.diags_array(f.astype(float)) for f in (free, free[: 3 * n_corners]))
        matrix = sparse.csr_array(fine @ sparse.kron(nodal, sparse.eye_array(3)) @ coarse)
        matrix.eliminate_zeros()
        return matrix

    def _largest_eigenvalue(self) -> float:
        n_u = self.elasticity.n_displacements
        v, out = np.zeros(self._residual.shape), wp.zeros_like(self._residual)

        def apply(u):
            v[:n_u] = u[:, None]
            self._residual.assign(v)
            self._tangent(self._residual, self._action)
            out.zero_()
            self._smooth(self._action, out)
            return out.numpy()[:n_u, 0]

        return largest_eigenvalue(apply, n_u)

    def _invert_diagonal(self):
        columns.clear(self.active, self._blocks)
        for term in (self.elasticity, *self.contacts):
            term.diagonal(self._blocks)
        self._launch(invert_kernel, [self._blocks, self._nodes, self.held, self.active], [self._inverse])

    def update(self):
        """Follow the last linearisation in the active environments."""
        self._invert_diagonal()
        self.corners.update()

    def _launch(self, kernel, inputs, outputs):
        wp.launch(kernel, dim=self._inverse.shape, inputs=inputs, outputs=outputs, device=self._inverse.device)

    def _smooth(self, residual, x_out):
        inputs = [self._inverse, residual, *self._smoothing, self.active]
        self._launch(smooth_kernel, inputs, [self._direction, x_out])

    def _remainder(self, b, x):
        self._tangent(x, self._action)
        inputs = [b, self._action]
        wp.launch(difference_kernel, dim=b.shape, inputs=inputs, outputs=[self._residual], device=b.device)

    def apply(self, b, x_out):
        """Change the displacements in x, which are zero, to about K^-1 (b - B^T p), p being the pressures in x."""
        self._smooth(b, x_out)  # knows nothing of p; what it leaves out remains
        self._remainder(b, x_out)
        self.transfer.restrict(self._residual, self._corner_b)
        self.corners.apply(self._corner_b, self._corner_x)
        self.transfer.prolong(self._corner_x, x_out)
        self._remainder(b, x_out)
        self._smooth(self._residual, x_out)
