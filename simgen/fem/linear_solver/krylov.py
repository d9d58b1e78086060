"""Batched conjugate residuals (GCR): every environment solves its own system and stops at its own tolerance.

Eisenstat, Elman and Schultz, SIAM J. Numer. Anal. 20, 1983. All directions are stored, so the preconditioner may be any
map. The image of a direction is the operator's action on it. The search space is that of GMRES as long as all images
are stored. The residual extends the space as long as the residual changes. Where it stagnates (an indefinite matrix),
the last image extends the space; it is always new (Young and Jea's Orthodir, Linear Algebra Appl. 34, 1980). Images are
made orthogonal, directions are not: steps along images are turned into steps along directions at the end, as GMRES
does, so a direction is written once and read once. Vectors are in single precision, scaled by the norm of the
right-hand side. Inner products are summed in double precision, on a CPU always in the same order.

Environments begin at any time and keep their directions until they finish, so a slow one does not hold up the others.
On a GPU some iterations of all environments are one graph.
"""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import warp as wp

from simgen.fem import batch_arrays
from simgen.fem.chunks import chunks
from simgen.fem.device import launch_kernel, once, read, recording
from simgen.fem.linear_solver.krylov_kernels import (
    IMAGES_PER_THREAD,
    STRICT_ITERATIONS,
    WINDOW,
    advance_kernel,
    begin_kernel,
    check_convergence_kernel,
    clear_dots_kernel,
    clear_kernel,
    compact_kernel,
    dots_kernel,
    end_kernel,
    orthogonalize_kernel,
    project_kernel,
    seed_kernel,
    select_unsolved_kernel,
    substitute_kernel,
)


class Dots:
    """Inner products of pairs of vectors (n, env) in the active environments: ``values`` (env,), on the device."""

    def __init__(self, n: int, active):
        self._n_chunks, self._active = chunks(n), active
        self.values = wp.zeros(len(active), dtype=wp.float64, device=active.device)

    def __call__(self, a, b):
        # Not `batch_arrays.clear`: a graph on a CPU takes another type's version of a kernel (Warp 1.19).
        batch_arrays.launch(clear_dots_kernel, (), [self._active], [self.values])
        batch_arrays.launch(dots_kernel, self._n_chunks, [a, b, self._active], [self.values])
        return self.values


class ConjugateResiduals:
    """Solver of systems of ``n`` unknowns, one for each environment, in at most ``size`` iterations.

    ``active`` lists the environments that take part. The operator and the preconditioner read it too.
    """

    def __init__(self, n: int, size: int, device, active):
        self.size, self.device, self.active, self.n_env = size, device, active, active.shape[0]

        def array(shape, dtype):
            return wp.zeros(shape, dtype=dtype, device=device)

        self._directions = array((size, n, self.n_env), wp.float32)
        self._images = array((WINDOW, n, self.n_env), wp.float32)
        self._residual, self._direction, self._image = (array((n, self.n_env), wp.float32) for _ in range(3))
        self._seed = array((n, self.n_env), wp.float32)
        self._products = array((size, size, self.n_env), wp.float64)
        self._inverse_squares, self._steps = (array((size, self.n_env), wp.float64) for _ in range(2))
        self._square, self._along, self._residual_square = (array(self.n_env, wp.float64) for _ in range(3))
        self._norm, self._graphs = Dots(n, active), {}
        self._ended = np.zeros(self.n_env, dtype=int), np.zeros(self.n_env)  # iterations, residuals: the last advance's
        self._size, self._relative = (array(self.n_env, wp.float64) for _ in range(2))
        self._count, self._stagnated = (array(self.n_env, wp.int32) for _ in range(2))
        self._keep, self._kept = (array(self.n_env, wp.int32) for _ in range(2))
        self._iterations, self._unfinished = (array(1, wp.int32) for _ in range(2))

    def begin(self, b):
        """Start on the systems of the active environments, with right-hand sides b."""
        inputs = [b, self._norm(b, b), self.active]
        outputs = [self._residual, self._size, self._count, self._relative, self._stagnated]
        batch_arrays.launch(begin_kernel, len(b), inputs, outputs)

    def advance(
        self, operator, preconditioner, tolerance: float, loose: float, most: int, together=0, capture=False
    ) -> np.ndarray:
        """Advance the systems ``operator x = b`` of the active environments by at most ``most`` iterations.

        ``operator(v, out)`` and ``preconditioner(v, out)`` overwrite ``out``. A system has finished when its residual
        over b is at most ``tolerance`` (from iteration `STRICT_ITERATIONS` on at most ``loose``), or after ``size``
        iterations. Returns the environments (env,) bool that have not finished; ``active`` then lists these alone.

        together : number of first iterations in which finished systems go on with the others, down to `TIGHT`. On a GPU
            an iteration of half of them costs as much as one of all, and Newton's method profits
        capture : record the loop as one graph. Both functions must only launch kernels, always on the same arrays
        """
        began = self.active.chosen
        self.active.shortened()
        n_chunks = chunks(len(self._residual))
        self._iterations.zero_()
        batch_arrays.launch(select_unsolved_kernel, (), [self._relative, self.active], [self._keep])
        self._compact(most)

        def iterate():
            inputs = [self._residual, self._images, self._inverse_squares, self._count, self._stagnated, self.active]
            batch_arrays.launch(seed_kernel, n_chunks, inputs, [self._seed])
            preconditioner(self._seed, self._direction)
            operator(self._direction, self._image)
            self._finish_iteration(n_chunks, (tolerance, loose), most, together)

        key = (operator, preconditioner, tolerance, loose, most, together, self.active.lanes)
        if capture and key in self._graphs:
            wp.capture_launch(self._graphs[key])
        else:
            with once() if capture else nullcontext():
                wp.capture_while(self._unfinished, iterate)  # also loads the kernels, which a capture cannot do
            if capture:
                with recording(self.device) as recorded:
                    wp.capture_while(self._unfinished, iterate)
                self._graphs[key] = recorded.graph
        count, relative = self._ended = read(self._count, self._relative)
        missed = relative > np.where(count >= STRICT_ITERATIONS, loose, tolerance)
        return began & missed & (count < self.size) & np.isfinite(relative)

    def end(self, x_out) -> tuple[np.ndarray, np.ndarray]:
        """Write the solutions of the active environments to ``x_out``, after :meth:`advance`.

        Returns iterations (env,) and relative residuals (env,) of all environments, infinite where a system broke down.
        """
        inputs = [self._products, self._inverse_squares, self._count, self.active]
        batch_arrays.launch(substitute_kernel, (), inputs, [self._steps])
        inputs = [self._directions, self._steps, self._count, self._size, self.active]
        batch_arrays.launch(end_kernel, len(x_out), inputs, [x_out])
        count, relative = self._ended
        return count.astype(int), relative

    def solve(self, operator, preconditioner, b, x_out, tolerance: float):
        """Solve from beginning to end; returns the results of :meth:`end`, 0 in environments that were not active."""
        began = self.active.chosen
        self.begin(b)
        self.advance(operator, preconditioner, tolerance, tolerance, self.size)
        self.active.choose(began)
        iterations, relative = self.end(x_out)
        return iterations * began, np.where(began, relative, 0.0)

    def _finish_iteration(self, n_chunks, tolerances: tuple[float, float], most: int, together: int):
        """Turn the new direction and its image into the next residual."""
        count, active = self._count, self.active
        sums = [self._square, self._along, self._residual_square]
        batch_arrays.launch(clear_kernel, (), [count, active], [self._products, *sums])
        inputs = [self._images, self._image, count, active]
        batch_arrays.launch(project_kernel, (n_chunks, WINDOW // IMAGES_PER_THREAD), inputs, [self._products])
        inputs = [self._direction, self._image, self._residual, self._products, self._inverse_squares, count, active]
        outputs = [self._directions, self._images, self._square, self._along]
        batch_arrays.launch(orthogonalize_kernel, n_chunks, inputs, outputs)
        inputs = [self._images, self._square, self._along, count, active]
        outputs = [self._inverse_squares, self._steps, self._residual, self._residual_square]
        batch_arrays.launch(advance_kernel, n_chunks, inputs, outputs)
        inputs = [self._residual_square, *tolerances, self.size, self._iterations, together, active]
        batch_arrays.launch(check_convergence_kernel, (), inputs, [count, self._stagnated, self._relative, self._keep])
        self._compact(most)

    def _compact(self, most: int):
        """Shorten the list of active environments to those to keep."""
        outputs = [self._kept, self._iterations, self._unfinished]
        inputs, numbers = [self._keep, self.active.numbers, most], self.active.numbers
        launch_kernel(compact_kernel, dim=self.n_env, inputs=inputs, outputs=outputs, device=self.device)
        wp.copy(numbers, self._kept)
