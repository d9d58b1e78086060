"""Multigrid for linear displacements: a V-cycle of Chebyshev smoothing and the coarsest level."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
import warp as wp

from simgen.fem import batch_arrays, groups
from simgen.fem.batch_arrays import Envs, Indices, SingleVectors
from simgen.fem.blocks import clear, load, store, zeros
from simgen.fem.columns import add_vector
from simgen.fem.elements.elasticity import Elasticity
from simgen.fem.groups import cpu_kernel, gpu_kernel, group_at
from simgen.fem.linear_solver import rounded_blocks
from simgen.fem.linear_solver.aggregation import coarse_space, largest_eigenvalue
from simgen.fem.linear_solver.coarse_level import CoarseLevel
from simgen.fem.linear_solver.group_rows import FOR_EACH_CHOSEN, block_row
from simgen.fem.linear_solver.pattern import BlockPattern
from simgen.fem.linear_solver.rounded_blocks import RoundedBlocks, invert_kernel, of_environment, rounded_block
from simgen.fem.precision import single, vec3f

wp.set_module_options({"enable_backward": False})

LINEAR_SPREAD, LINEAR_STEPS = 10.0, 3  # largest over smallest eigenvalue that is smoothed; steps of the smoother
UNROLLED = wp.constant(4)  # blocks of a row that a thread loads at once
PART = wp.constant(4)  # blocks of a thread where threads share a row
MARGIN = 1.15  # on the largest eigenvalue at rest, which contact and large strains raise a little


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


@wp.func
def row_residual(
    row_starts: Indices, columns: Indices, blocks: RoundedBlocks, x: SingleVectors, b: SingleVectors, row: wp.int32,
    env: wp.int32,
) -> vec3f:
    r, begin, end = load(b, row, env), row_starts[row], row_starts[row + 1]
    whole = begin + (end - begin) / UNROLLED * UNROLLED
    for first in range(begin, whole, UNROLLED):
        for i in range(UNROLLED):
            r -= rounded_block(blocks, first + i, env) * load(x, columns[first + i], env)
    for k in range(whole, end):
        r -= rounded_block(blocks, k, env) * load(x, columns[k], env)
    return r


@wp.func
def smooth(
    inverse: RoundedBlocks, r: vec3f, x: SingleVectors, keep: single, step: single, row: wp.int32, env: wp.int32,
    direction: SingleVectors, x_out: SingleVectors,
):
    """One Chebyshev step for the row's residual r."""
    d = step * (rounded_block(inverse, row, env) * r)
    if keep != 0.0:
        d += keep * load(direction, row, env)
    store(direction, row, env, d)
    store(x_out, row, env, load(x, row, env) + d)


@gpu_kernel
def subtract_parts_kernel(
    row_starts: Indices, columns: Indices, blocks: RoundedBlocks, x: SingleVectors, active: Envs,
    # outputs
    residual_out: SingleVectors,
):
    """Subtract M x; each thread subtracts a part of a row."""
    row, part, lane = wp.tid()
    env = active[lane]
    first = row_starts[row] + PART * part
    last = wp.min(first + PART, row_starts[row + 1])
    if env < 0 or first >= last:
        return
    total = vec3f()
    for k in range(first, last):
        total += rounded_block(blocks, k, env) * load(x, columns[k], env)
    add_vector(residual_out, 3 * row, env, -total)


@gpu_kernel
def smooth_kernel(
    inverse: RoundedBlocks, residual: SingleVectors, x: SingleVectors, keep: single, step: single, active: Envs,
    # outputs
    direction_out: SingleVectors, x_out: SingleVectors,
):
    row, lane = wp.tid()
    env = active[lane]
    if env >= 0:
        smooth(inverse, load(residual, row, env), x, keep, step, row, env, direction_out, x_out)


@gpu_kernel
def residual_kernel(
    row_starts: Indices, columns: Indices, blocks: RoundedBlocks, x: SingleVectors, b: SingleVectors, active: Envs,
    # outputs
    residual_out: SingleVectors,
):
    row, lane = wp.tid()
    env = active[lane]
    if env >= 0:
        store(residual_out, row, env, row_residual(row_starts, columns, blocks, x, b, row, env))


@wp.kernel
def chebyshev_start_kernel(
    inverse: RoundedBlocks, b: SingleVectors, step: single, active: Envs,
    # outputs
    direction_out: SingleVectors, x_out: SingleVectors,
):
    """The first step, from x = 0."""
    row, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    d = step * (rounded_block(inverse, row, env) * load(b, row, env))
    store(direction_out, row, env, d)
    store(x_out, row, env, d)


@gpu_kernel
def chebyshev_kernel(
    row_starts: Indices, columns: Indices, blocks: RoundedBlocks, inverse: RoundedBlocks, x: SingleVectors,
    b: SingleVectors, keep: single, step: single, active: Envs,
    # outputs
    direction_out: SingleVectors, x_out: SingleVectors,
):
    row, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    r = row_residual(row_starts, columns, blocks, x, b, row, env)
    smooth(inverse, r, x, keep, step, row, env, direction_out, x_out)


@wp.func_native(block_row(f"{FOR_EACH_CHOSEN} {store.native_func}(residual, row, l, r(l));", vectors=("residual",)))
def group_residual(
    row_starts: Indices, columns: Indices, blocks: RoundedBlocks, x: SingleVectors, b: SingleVectors, row: wp.int32,
    first: wp.int32, chosen: wp.int32, residual: SingleVectors,
): ...


# The compiler does not vectorise a loop with a condition on ``keep`` inside.
_SMOOTH = f"""
    if (keep == 0.0f) {{
        {FOR_EACH_CHOSEN} {smooth.native_func}(inverse, r(l), x, 0.0f, step, row, l, direction, x_out);
    }} else {{
        {FOR_EACH_CHOSEN} {smooth.native_func}(inverse, r(l), x, keep, step, row, l, direction, x_out);
    }}
"""


@wp.func_native(block_row(_SMOOTH, vectors=("direction", "x_out"), blocks=("inverse",)))
def group_smooth(
    row_starts: Indices, columns: Indices, blocks: RoundedBlocks, inverse: RoundedBlocks, x: SingleVectors,
    b: SingleVectors, keep: single, step: single, row: wp.int32, first: wp.int32, chosen: wp.int32,
    direction: SingleVectors, x_out: SingleVectors,
): ...


@cpu_kernel
def group_residual_kernel(
    row_starts: Indices, columns: Indices, blocks: RoundedBlocks, x: SingleVectors, b: SingleVectors, active: Envs,
    # outputs
    residual_out: SingleVectors,
):
    row, lane = wp.tid(), wp.int32(0)
    first, count, group = group_at(active, lane, x.shape[1])
    while count > 0:
        if group == 0:
            for k in range(lane, lane + count):
                store(residual_out, row, active[k], row_residual(row_starts, columns, blocks, x, b, row, active[k]))
        else:
            group_residual(row_starts, columns, blocks, x, b, row, first, group, residual_out)
        lane += count
        first, count, group = group_at(active, lane, x.shape[1])


@cpu_kernel
def group_chebyshev_kernel(
    row_starts: Indices, columns: Indices, blocks: RoundedBlocks, inverse: RoundedBlocks, x: SingleVectors,
    b: SingleVectors, keep: single, step: single, active: Envs,
    # outputs
    direction_out: SingleVectors, x_out: SingleVectors,
):
    row, lane = wp.tid(), wp.int32(0)
    first, count, group = group_at(active, lane, x.shape[1])
    while count > 0:
        if group == 0:
            for k in range(lane, lane + count):
                r = row_residual(row_starts, columns, blocks, x, b, row, active[k])
                smooth(inverse, r, x, keep, step, row, active[k], direction_out, x_out)
        else:
            group_smooth(
                row_starts, columns, blocks, inverse, x, b, keep, step, row, first, group, direction_out, x_out
            )
        lane += count
        first, count, group = group_at(active, lane, x.shape[1])


class LinearMultigrid:
    """V-cycle for linear displacements, on 3 x 3 blocks that are assembled for each state."""

    def __init__(self, elasticity: Elasticity, contacts: list, fixed):
        self.elasticity, self.contacts, self.active = elasticity, contacts, elasticity.active
        n, n_env, device = elasticity.n_corners, self.active.shape[0], elasticity.device
        faces = [contact.host_faces[:, :3] for contact in contacts]
        self.pattern = BlockPattern(n, elasticity.host_tetrahedra[:, :4], faces, device)
        self.fixed = fixed[: 3 * n]
        self._parts_of_longest_row = -(-int(np.diff(self.pattern.host_row_starts).max()) // PART)
        self._n, self._blocks = n, zeros(self.pattern.n_blocks, n_env, device)
        self._rounded = rounded_blocks.zeros(self.pattern.n_blocks, n_env, device)
        self._inverse = rounded_blocks.zeros(n, n_env, device)
        self._residual, self._direction, self._x = (
            wp.zeros((3 * n, n_env), dtype=wp.float32, device=device) for _ in range(3)
        )
        diagonal = np.repeat(np.arange(n), np.diff(self.pattern.host_row_starts)) == self.pattern.host_columns
        self._diagonal = wp.array(np.flatnonzero(diagonal), dtype=wp.int32, device=device)
        self._assemble()
        matrix = self.pattern.matrix(of_environment(self._rounded, 0))
        inverse = of_environment(self._inverse, 0)
        inverse = sparse.csr_array(sparse.bsr_array((inverse, np.arange(n), np.arange(n + 1)), shape=matrix.shape))
        largest = largest_eigenvalue(lambda v: inverse @ (matrix @ v), 3 * n)
        self._smoothing = chebyshev(largest, LINEAR_STEPS, LINEAR_SPREAD)
        space = coarse_space(self.pattern.graph(), elasticity.host_nodes[:n], self.fixed.numpy() == 0)
        self.coarse = CoarseLevel(self.pattern, space, self.active)
        self.coarse.rebuild(self._blocks)

    @property
    def matrices(self) -> list[wp.array]:
        """Matrices of each environment that :meth:`apply` reads, (tile, row, place in the tile)."""
        return [self._rounded, self._inverse, self.coarse.inverse]

    def rebuild(self):
        """Rebuild both levels from the last linearisation of the active environments."""
        self._assemble()
        self.coarse.rebuild(self._blocks)

    def _assemble(self):
        """Assemble and round the blocks of the last linearisation, and invert the diagonal ones."""
        clear(self._blocks, self.active)
        self.elasticity.blocks(self.pattern.tet_index, self._blocks, linear=True)
        for contact, index in zip(self.contacts, self.pattern.face_index, strict=True):
            contact.blocks(index, self._blocks, linear=True)
        rounded_blocks.round_blocks(self._blocks, self.pattern.n_blocks, self.active, self._rounded)
        self._launch(invert_kernel, [self._blocks, self._diagonal, self.fixed, self.active], [self._inverse])

    def _launch(self, kernel, inputs, outputs):
        batch_arrays.launch(kernel, self._n, inputs, outputs)

    def _rows(self):
        return [self.pattern.row_starts, self.pattern.columns, self._rounded]

    def _find_residual(self, x, b):
        """Compute b - K x. With few presses, several threads of a GPU share a row.

        A cycle on the default DIGIT then takes 102 to 114 us instead of 161 to 248 with one to four presses, 126
        instead of 172 with 8, and 164 instead of 178 with 32 (one H200, 58e493a, by a script that is not kept).
        """
        if self.active.few:
            batch_arrays.copy(b, self.active, self._residual)
            inputs = [*self._rows(), x, self.active]
            batch_arrays.launch(subtract_parts_kernel, (self._n, self._parts_of_longest_row), inputs, [self._residual])
        else:
            inputs = [*self._rows(), x, b, self.active]
            groups.launch(group_residual_kernel, residual_kernel, self._n, inputs, [self._residual])

    def _steps(self, coefficients, b, x, other):
        """Chebyshev steps, from x to the other array and back; returns x and the other array after the last step."""
        for keep, step in coefficients:
            if self.active.few:
                self._find_residual(x, b)
                inputs = [self._inverse, self._residual, x, keep, step, self.active]
                self._launch(smooth_kernel, inputs, [self._direction, other])
            else:
                inputs = [*self._rows(), self._inverse, x, b, keep, step, self.active]
                groups.launch(group_chebyshev_kernel, chebyshev_kernel, self._n, inputs, [self._direction, other])
            x, other = other, x
        return x, other

    def apply(self, b, x_out):
        """Approximate x = K^-1 b by one V-cycle."""
        (_, first), *others = self._smoothing
        x, other = self._x, x_out  # after an odd number of swaps, x_out is x
        self._launch(chebyshev_start_kernel, [self._inverse, b, first, self.active], [self._direction, x])
        x, other = self._steps(others, b, x, other)
        self._find_residual(x, b)
        self.coarse.correct(self._residual, x)
        self._steps(self._smoothing, b, x, other)
