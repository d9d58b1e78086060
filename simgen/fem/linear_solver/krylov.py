"""Batched conjugate residuals (GCR): every environment solves its own system and stops at its own tolerance.

Eisenstat, Elman and Schultz, SIAM J. Numer. Anal. 20, 1983. With the directions kept, the preconditioner may be any
map. The space is GMRES's as long as all images are kept: the residual adds to it as long as it changes, and where it
does not (an indefinite matrix), the last image does, which always is new (Young and Jea's Orthodir, Linear Algebra
Appl. 34, 1980). Images are made orthogonal, directions are not: steps along the ones are turned into steps along the
others when the solution is asked for, as GMRES does, and a direction is written once and read once. Vectors are in
single precision, scaled by the norm of the right-hand side; inner products are summed in double precision, on a CPU in
the same order every time.

Environments begin when they like, and each keeps its directions until it has finished: a slow one does not hold the
others up. On a GPU some iterations of all of them are one graph.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from simgen.fem import batch_arrays
from simgen.fem.device import read, recording
from simgen.fem.linear_solver.krylov_kernels import (
    SOON,
    TOGETHER,
    WINDOW,
    advance_kernel,
    begin_kernel,
    clear_kernel,
    close_ranks_kernel,
    dots_kernel,
    end_kernel,
    judge_kernel,
    orthogonalize_kernel,
    project_kernel,
    rest_kernel,
    source_kernel,
    substitute_kernel,
)
from simgen.fem.sections import chunks

EXACT = 1e-3  # relative residual below which an inexact Newton method gains nothing


class Dots:
    """Inner products of pairs of vectors (n, env), on the device as ``values`` (env,); those not active stay."""

    def __init__(self, n: int, active):
        self._sections, self._active = chunks(n), active
        self.values = wp.zeros(len(active), dtype=wp.float64, device=active.device)

    def __call__(self, a, b):
        batch_arrays.clear(self._active, self.values.reshape((1, -1)))
        batch_arrays.launch(dots_kernel, self._sections, [a, b, self._active], [self.values])
        return self.values


class ConjugateResiduals:
    """Work space for systems of ``n`` unknowns, one for each environment; at most ``size`` iterations.

    ``active`` lists the environments that take part. The operator and the preconditioner read it too.
    """

    def __init__(self, n: int, size: int, device, active):
        self.size, self.device, self.active, self.n_env = size, device, active, active.shape[0]

        def array(shape, dtype):
            return wp.zeros(shape, dtype=dtype, device=device)

        self._directions = array((size, n, self.n_env), wp.float32)
        self._images = array((WINDOW, n, self.n_env), wp.float32)
        self._residual, self._direction, self._image = (array((n, self.n_env), wp.float32) for _ in range(3))
        self._source = array((n, self.n_env), wp.float32)
        self._products = array((size, size, self.n_env), wp.float64)
        self._inverse_squares, self._steps = (array((size, self.n_env), wp.float64) for _ in range(2))
        self._square, self._along, self._left = (array(self.n_env, wp.float64) for _ in range(3))
        self._norm, self._graphs = Dots(n, active), {}
        self._size, self._relative = (array(self.n_env, wp.float64) for _ in range(2))
        self._count, self._stuck = (array(self.n_env, wp.int32) for _ in range(2))
        self._keep, self._kept = (array(self.n_env, wp.int32) for _ in range(2))
        self._ticks, self._going = (array(1, wp.int32) for _ in range(2))

    def begin(self, b):
        """Start on the systems of the active environments, with right-hand sides b."""
        inputs = [b, self._norm(b, b), self.active]
        outputs = [self._residual, self._size, self._count, self._relative, self._stuck]
        batch_arrays.launch(begin_kernel, len(b), inputs, outputs)

    def go_on(
        self, operator, preconditioner, tolerance: float, later: float, most: int, together=False, capture=False
    ) -> np.ndarray:
        """Carry the systems ``operator x = b`` of the active environments on by at most ``most`` iterations.

        One has finished when its residual is ``tolerance`` times b, from iteration `SOON` on ``later`` times b, or
        after ``size`` iterations. ``operator(v, out)`` and ``preconditioner(v, out)`` overwrite ``out``. Returns which
        environments (env,) have not finished; ``active`` lists nothing of use then.

        ``together`` says that those that have finished go on with the others, to `EXACT`: on a GPU an iteration of half
        of them costs as much as one of all, whose numbers lie between theirs, and Newton's method has use for it.
        ``capture`` says that both functions do nothing but launch kernels on the same arrays every time: the loop then
        becomes one graph.
        """
        began = batch_arrays.env_mask(self.active.numpy())
        tolerances = tolerance, later, EXACT if together else np.inf
        sections = chunks(len(self._residual))
        self._ticks.zero_()
        batch_arrays.launch(rest_kernel, (), [self._relative, self.active], [self._keep])
        self._close_ranks(most)

        def iterate():
            inputs = [self._residual, self._images, self._inverse_squares, self._count, self._stuck, self.active]
            batch_arrays.launch(source_kernel, sections, inputs, [self._source])
            preconditioner(self._source, self._direction)
            operator(self._direction, self._image)
            self._advance(sections, tolerances, most)

        key = (operator, preconditioner, *tolerances, most, self.active.lanes)
        if capture and key in self._graphs:
            wp.capture_launch(self._graphs[key])
        else:
            wp.capture_while(self._going, iterate)  # and loads all kernels, which cannot be done while one captures
            if capture:
                with recording(self.device) as recorded:
                    wp.capture_while(self._going, iterate)
                self._graphs[key] = recorded.graph
        count, relative = read(self._count, self._relative)
        missed = relative > np.where(count >= SOON, later, tolerance)
        return began & missed & (count < self.size) & np.isfinite(relative)

    def end(self, x_out) -> tuple[np.ndarray, np.ndarray]:
        """Solutions of the active environments into their columns of ``x_out``.

        Returns iterations (env,) and relative residuals (env,) of all, infinite where a system broke down.
        """
        inputs = [self._products, self._inverse_squares, self._count, self.active]
        batch_arrays.launch(substitute_kernel, (), inputs, [self._steps])
        inputs = [self._directions, self._steps, self._count, self._size, self.active]
        batch_arrays.launch(end_kernel, len(x_out), inputs, [x_out])
        count, relative = read(self._count, self._relative)
        return count.astype(int), relative.copy()

    def solve(self, operator, preconditioner, b, x_out, tolerance: float):
        """Begin, go on to the end and return what :meth:`end` does, zeros where nothing was active."""
        began = self.active.numpy().copy()
        self.begin(b)
        self.go_on(operator, preconditioner, tolerance, tolerance, self.size)
        self.active.assign(began)
        iterations, relative = self.end(x_out)
        took_part = batch_arrays.env_mask(began)
        return iterations * took_part, np.where(took_part, relative, 0.0)

    def _advance(self, sections, tolerances: tuple[float, float, float], most: int):
        """From the new direction and its image to the next residual."""
        count, active = self._count, self.active
        sums = [self._square, self._along, self._left]
        batch_arrays.launch(clear_kernel, (), [count, active], [self._products, *sums])
        inputs = [self._images, self._image, count, active]
        batch_arrays.launch(project_kernel, (sections, WINDOW // TOGETHER), inputs, [self._products])
        inputs = [self._direction, self._image, self._residual, self._products, self._inverse_squares, count, active]
        outputs = [self._directions, self._images, self._square, self._along]
        batch_arrays.launch(orthogonalize_kernel, sections, inputs, outputs)
        inputs = [self._images, self._square, self._along, count, active]
        outputs = [self._inverse_squares, self._steps, self._residual, self._left]
        batch_arrays.launch(advance_kernel, sections, inputs, outputs)
        inputs = [self._left, *tolerances, self.size, active]
        batch_arrays.launch(judge_kernel, (), inputs, [count, self._stuck, self._relative, self._keep])
        self._close_ranks(most)

    def _close_ranks(self, most: int):
        """Shorten the list of the active ones to those to keep."""
        outputs = [self._kept, self._ticks, self._going]
        inputs, numbers = [self._keep, self.active.numbers, most], self.active.numbers
        wp.launch(close_ranks_kernel, dim=self.n_env, inputs=inputs, outputs=outputs, device=self.device)
        wp.copy(numbers, self._kept)
