"""Batched conjugate residuals (GCR): every environment solves its own system and stops at its own tolerance.

Eisenstat, Elman and Schultz, SIAM J. Numer. Anal. 20, 1983. With the directions kept, the preconditioner may be any
map. The space is GMRES's: the residual adds to it as long as it changes, and where it does not (an indefinite matrix),
the last image does, which always is new (Young and Jea's Orthodir, Linear Algebra Appl. 34, 1980). Vectors are in
single precision, scaled by the norm of the right-hand side; inner products are summed in double precision, in the same
order every time.

The host is not asked before the last environment has finished: on a GPU the loop is one graph.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from .material import real, single

wp.set_module_options({"enable_backward": False})

CHUNK = 512  # terms that one thread sums
STUCK = 0.9  # of the last residual: one that shrinks less says little that is new
SOON = 4  # iterations after which a looser tolerance holds


@wp.kernel
def dots_kernel(
    a: wp.array2d(dtype=Any),
    b: wp.array2d(dtype=Any),
    # outputs
    parts_out: wp.array3d(dtype=wp.float64),
):
    c, env = wp.tid()
    total = real(0.0)
    for i in range(c * CHUNK, wp.min((c + 1) * CHUNK, a.shape[0])):
        total += real(a[i, env]) * real(b[i, env])
    parts_out[0, c, env] = total


@wp.kernel
def sum_kernel(
    parts: wp.array3d(dtype=wp.float64),
    # outputs
    sums_out: wp.array2d(dtype=wp.float64),
):
    k, env = wp.tid()
    total = real(0.0)
    for c in range(parts.shape[1]):
        total += parts[k, c, env]
    sums_out[k, env] = total


@wp.kernel
def begin_kernel(
    b: wp.array2d(dtype=wp.float64),
    squares: wp.array2d(dtype=wp.float64),
    # outputs
    residual_out: wp.array2d(dtype=wp.float32),
):
    i, env = wp.tid()
    size = wp.sqrt(squares[0, env])
    value = real(0.0)
    if size > real(0.0):
        value = b[i, env] / size
    residual_out[i, env] = single(value)


@wp.kernel
def project_kernel(
    images: wp.array3d(dtype=wp.float32),
    image: wp.array2d(dtype=wp.float32),
    count: wp.array(dtype=wp.int32),
    active: wp.array(dtype=wp.int32),
    # outputs
    parts_out: wp.array3d(dtype=wp.float64),
):
    """Inner products of the new image with those before it."""
    k, c, env = wp.tid()
    if k >= count[0] or active[env] == 0:
        return
    total = real(0.0)
    for i in range(c * CHUNK, wp.min((c + 1) * CHUNK, image.shape[0])):
        total += real(images[k, i, env] * image[i, env])
    parts_out[k, c, env] = total


@wp.kernel
def orthogonalize_kernel(
    directions: wp.array3d(dtype=wp.float32),
    images: wp.array3d(dtype=wp.float32),
    coefficients: wp.array2d(dtype=wp.float64),
    count: wp.array(dtype=wp.int32),
    active: wp.array(dtype=wp.int32),
    # outputs
    direction_out: wp.array2d(dtype=wp.float32),
    image_out: wp.array2d(dtype=wp.float32),
):
    i, env = wp.tid()
    if active[env] == 0:
        return
    z = direction_out[i, env]
    q = image_out[i, env]
    for k in range(count[0]):
        coefficient = single(coefficients[k, env])
        z -= coefficient * directions[k, i, env]
        q -= coefficient * images[k, i, env]
    direction_out[i, env] = z
    image_out[i, env] = q


@wp.kernel
def measure_kernel(
    residual: wp.array2d(dtype=wp.float32),
    image: wp.array2d(dtype=wp.float32),
    active: wp.array(dtype=wp.int32),
    # outputs
    parts_out: wp.array3d(dtype=wp.float64),
):
    """Squares of the image, and its inner product with the residual."""
    c, env = wp.tid()
    if active[env] == 0:
        return
    square, product = real(0.0), real(0.0)
    for i in range(c * CHUNK, wp.min((c + 1) * CHUNK, image.shape[0])):
        q = image[i, env]
        square += real(q * q)
        product += real(q * residual[i, env])
    parts_out[0, c, env] = square
    parts_out[1, c, env] = product


@wp.kernel
def advance_kernel(
    direction: wp.array2d(dtype=wp.float32),
    image: wp.array2d(dtype=wp.float32),
    sums: wp.array2d(dtype=wp.float64),
    count: wp.array(dtype=wp.int32),
    active: wp.array(dtype=wp.int32),
    # outputs
    directions_out: wp.array3d(dtype=wp.float32),
    images_out: wp.array3d(dtype=wp.float32),
    x_out: wp.array2d(dtype=wp.float32),
    residual_out: wp.array2d(dtype=wp.float32),
    parts_out: wp.array3d(dtype=wp.float64),
):
    """Keep the direction and its image, of length one, and go along it; squares of the residual that is left."""
    c, env = wp.tid()
    if active[env] == 0:
        return
    length = wp.sqrt(sums[0, env])
    scale, step = single(real(1.0) / length), single(sums[1, env] / length)
    square = real(0.0)
    for i in range(c * CHUNK, wp.min((c + 1) * CHUNK, image.shape[0])):
        z, q = scale * direction[i, env], scale * image[i, env]
        directions_out[count[0], i, env] = z
        images_out[count[0], i, env] = q
        x_out[i, env] = x_out[i, env] + step * z
        r = residual_out[i, env] - step * q
        residual_out[i, env] = r
        square += real(r * r)
    parts_out[0, c, env] = square


@wp.kernel
def count_kernel(count_out: wp.array(dtype=wp.int32), going_out: wp.array(dtype=wp.int32)):
    count_out[0] = count_out[0] + 1
    going_out[0] = 0


@wp.kernel
def judge_kernel(
    squares: wp.array2d(dtype=wp.float64),
    tolerance: real,
    later: real,
    count: wp.array(dtype=wp.int32),
    size: wp.int32,
    # outputs
    stuck_out: wp.array(dtype=wp.int32),
    found_out: wp.array2d(dtype=wp.float64),
    active_out: wp.array(dtype=wp.int32),
    going_out: wp.array(dtype=wp.int32),
):
    """Rows of ``found_out``: iterations, relative residual. A system that has broken down is not solved any further."""
    env = wp.tid()
    if active_out[env] == 0:
        return
    relative = wp.sqrt(squares[0, env])
    sound = wp.isfinite(relative)
    stuck_out[env] = int(relative > real(STUCK) * found_out[1, env])
    found_out[0, env] = real(count[0])
    found_out[1, env] = wp.where(sound, relative, real(wp.inf))
    if not sound or relative <= wp.where(count[0] >= SOON, later, tolerance):
        active_out[env] = 0
    elif count[0] < size:
        wp.atomic_max(going_out, 0, 1)


@wp.kernel
def source_kernel(
    residual: wp.array2d(dtype=wp.float32),
    images: wp.array3d(dtype=wp.float32),
    count: wp.array(dtype=wp.int32),
    stuck: wp.array(dtype=wp.int32),
    active: wp.array(dtype=wp.int32),
    # outputs
    source_out: wp.array2d(dtype=wp.float32),
):
    """What the next direction is made of."""
    i, env = wp.tid()
    if active[env] == 0:
        return
    value = residual[i, env]
    if stuck[env] == 1:
        value = images[count[0] - 1, i, env]
    source_out[i, env] = value


@wp.kernel
def end_kernel(
    x: wp.array2d(dtype=wp.float32),
    squares: wp.array2d(dtype=wp.float64),
    began: wp.array(dtype=wp.int32),
    # outputs
    x_out: wp.array2d(dtype=wp.float64),
):
    i, env = wp.tid()
    if began[env] == 0:
        return
    x_out[i, env] = wp.sqrt(squares[0, env]) * real(x[i, env])


def chunks(n: int) -> int:
    return -(-n // CHUNK)


class Dots:
    """Inner products of pairs of vectors (n, env), which stay on the device as ``values`` (1, env)."""

    def __init__(self, n: int, n_env: int, device):
        self._parts = wp.zeros((1, chunks(n), n_env), dtype=wp.float64, device=device)
        self.values = wp.zeros((1, n_env), dtype=wp.float64, device=device)

    def __call__(self, a, b):
        _, sections, n_env = self._parts.shape
        wp.launch(dots_kernel, dim=(sections, n_env), inputs=[a, b], outputs=[self._parts], device=a.device)
        wp.launch(sum_kernel, dim=(1, n_env), inputs=[self._parts], outputs=[self.values], device=a.device)
        return self.values


class ConjugateResiduals:
    """Work space for systems of ``n`` unknowns, one for each environment; at most ``size`` iterations.

    ``active`` (env,) int32 on the device says which environments take part: operator and preconditioner read it too.
    """

    def __init__(self, n: int, size: int, device, active):
        self.size, self.device, self.active, self.n_env = size, device, active, active.shape[0]

        def array(shape, dtype):
            return wp.zeros(shape, dtype=dtype, device=device)

        self._directions, self._images = (array((size, n, self.n_env), wp.float32) for _ in range(2))
        self._residual, self._direction, self._image = (array((n, self.n_env), wp.float32) for _ in range(3))
        self._x, self._source = (array((n, self.n_env), wp.float32) for _ in range(2))
        self._parts = array((max(size, 2), chunks(n), self.n_env), wp.float64)
        self._sums = array((max(size, 2), self.n_env), wp.float64)
        self._square, self._graphs = Dots(n, self.n_env, device), {}
        self._found = array((2, self.n_env), wp.float64)
        self._began, self._stuck = (array(self.n_env, wp.int32) for _ in range(2))
        self._count, self._going = (array(1, wp.int32) for _ in range(2))

    def _launch(self, kernel, dim, inputs, outputs):
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self.device)

    def solve(self, operator, preconditioner, b, x_out, tolerance: float, later: float = 0.0, capture=False):
        """Solve ``operator x = b`` until the residual is ``tolerance`` times b in every active environment.

        From iteration `SOON` on ``later`` times b is enough, if it is given: the slowest environment of a batch keeps
        the others waiting. ``operator(v, out)`` and ``preconditioner(v, out)`` overwrite ``out``; of ``x_out`` only
        active columns change. ``active`` is used up: it ends with the environments that missed. Returns iterations
        (env,) and relative residuals (env,), infinite where the system broke down; the caller judges what missed.

        ``capture`` says that both functions do nothing but launch kernels on the same arrays every time: the loop then
        becomes one graph.
        """
        whole, sections = b.shape, (chunks(b.shape[0]), self.n_env)
        wp.copy(self._began, self.active)
        squares = self._square(b, b)
        self._launch(begin_kernel, whole, [b, squares], [self._residual])
        self._x.zero_()
        self._count.zero_()
        self._found.fill_(1.0)
        self._stuck.zero_()
        size = np.sqrt(squares.numpy()[0])
        self.active.assign(np.where(size > 0.0, self.active.numpy(), 0).astype(np.int32))
        self._going.fill_(1)

        def iterate():
            inputs = [self._residual, self._images, self._count, self._stuck, self.active]
            self._launch(source_kernel, whole, inputs, [self._source])
            preconditioner(self._source, self._direction)
            operator(self._direction, self._image)
            self._advance(whole, sections, tolerance, max(tolerance, later))

        key = (operator, preconditioner, tolerance, later)
        if capture and key in self._graphs:
            wp.capture_launch(self._graphs[key])
        else:
            wp.capture_while(self._going, iterate)  # and loads all kernels, which cannot be done while one captures
            if capture:
                with wp.ScopedCapture(device=self.device) as captured:
                    wp.capture_while(self._going, iterate)
                self._graphs[key] = captured.graph
        self._launch(end_kernel, whole, [self._x, squares, self._began], [x_out])
        iterations, relative = np.where(self._began.numpy() * (size > 0.0), self._found.numpy(), 0.0)
        return iterations.astype(int), np.where(np.isfinite(size), relative, np.inf)

    def _advance(self, whole, sections, tolerance: float, later: float):
        """From the new direction and its image to the next residual."""
        every, count, active = (self.size, *sections), self._count, self.active
        self._launch(project_kernel, every, [self._images, self._image, count, active], [self._parts])
        self._launch(sum_kernel, (self.size, self.n_env), [self._parts], [self._sums])
        inputs = [self._directions, self._images, self._sums, count, active]
        self._launch(orthogonalize_kernel, whole, inputs, [self._direction, self._image])
        self._launch(measure_kernel, sections, [self._residual, self._image, active], [self._parts])
        self._launch(sum_kernel, (2, self.n_env), [self._parts], [self._sums])
        outputs = [self._directions, self._images, self._x, self._residual, self._parts]
        self._launch(advance_kernel, sections, [self._direction, self._image, self._sums, count, active], outputs)
        self._launch(sum_kernel, (1, self.n_env), [self._parts], [self._sums])
        self._launch(count_kernel, 1, [], [count, self._going])
        inputs = [self._sums, tolerance, later, count, self.size]
        self._launch(judge_kernel, self.n_env, inputs, [self._stuck, self._found, active, self._going])
