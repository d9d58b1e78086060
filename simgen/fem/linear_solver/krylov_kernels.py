"""Kernels of the conjugate residual method (see ``krylov``), for vectors (n, env) of the active environments."""

from __future__ import annotations

from typing import Any

import warp as wp

from simgen.fem.batch_arrays import Envs, Indices, Scalars, SingleVectors, Vectors
from simgen.fem.chunks import CHUNK, chunk_dot, load_chunk, store_chunk
from simgen.fem.precision import real, single

wp.set_module_options({"enable_backward": False})

STAGNATION = 0.9  # new over last residual: above, the next direction comes from the last image
# A new image is made orthogonal to so many last ones (Vinsome's Orthomin, SPE 5729, 1976). For a tolerance of 0.1 even
# 6 are enough (4 % more iterations under a cube 1.6 mm deep, none more elsewhere); for 1e-5 8 are too few.
WINDOW = 16
STRICT_ITERATIONS = 4  # from this iteration on the loose tolerance holds
TIGHT = 1e-3  # relative residual below which an inexact Newton method gains nothing more
IMAGES_PER_THREAD = 4  # inner products with a new image in one thread: most systems have no more images


@wp.kernel
def dots_kernel(a: wp.array2d(dtype=Any), b: wp.array2d(dtype=Any), active: Envs, products_out: Scalars):
    c, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    total = real(0.0)
    for i in range(c * CHUNK, wp.min((c + 1) * CHUNK, a.shape[0])):
        total += real(a[i, env]) * real(b[i, env])
    wp.atomic_add(products_out, env, total)


for _kind in (wp.float64, wp.float32):
    wp.overload(dots_kernel, {"a": wp.array2d(dtype=_kind), "b": wp.array2d(dtype=_kind)})


@wp.kernel
def clear_dots_kernel(active: Envs, products_out: Scalars):
    env = active[wp.tid()]
    if env >= 0:
        products_out[env] = real(0.0)


@wp.kernel
def begin_kernel(
    b: Vectors, squares: Scalars, active: Envs,
    # outputs
    residual_out: SingleVectors, size_out: Scalars, count_out: Indices, relative_out: Scalars, stagnated_out: Indices,
):
    i, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    size = wp.sqrt(squares[env])
    value = real(0.0)
    if size > real(0.0):
        value = b[i, env] / size
    residual_out[i, env] = single(value)
    if i == 0:
        size_out[env] = size
        count_out[env] = 0
        relative_out[env] = wp.where(wp.isfinite(size), wp.where(size > real(0.0), real(1.0), real(0.0)), real(wp.inf))
        stagnated_out[env] = 0


@wp.kernel
def clear_kernel(
    count: Indices, active: Envs,
    # outputs
    products_out: wp.array3d(dtype=wp.float64), square_out: Scalars, along_out: Scalars, residual_square_out: Scalars,
):
    env = active[wp.tid()]
    if env < 0:
        return
    last = count[env]
    for k in range(last):
        products_out[last, k, env] = real(0.0)
    square_out[env] = real(0.0)
    along_out[env] = real(0.0)
    residual_square_out[env] = real(0.0)


@wp.kernel
def project_kernel(
    images: wp.array3d(dtype=wp.float32), image: SingleVectors, count: Indices, active: Envs,
    # outputs
    products_out: wp.array3d(dtype=wp.float64),
):
    """Inner products of the new image with the last ones; each thread computes some of them."""
    c, group, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    last = count[env]
    if last <= group * IMAGES_PER_THREAD:
        return
    new = load_chunk(image, c, env)
    for back in range(IMAGES_PER_THREAD):
        k = last - 1 - group * IMAGES_PER_THREAD - back
        if k >= 0:
            wp.atomic_add(products_out, last, k, env, chunk_dot(load_chunk(images[k % WINDOW], c, env), new))


@wp.kernel
def orthogonalize_kernel(
    direction: SingleVectors, image: SingleVectors, residual: SingleVectors, products: wp.array3d(dtype=wp.float64),
    inverse_squares: Vectors, count: Indices, active: Envs,
    # outputs
    directions_out: wp.array3d(dtype=wp.float32), images_out: wp.array3d(dtype=wp.float32), square_out: Scalars,
    along_out: Scalars,
):
    """Store the direction and its image, made orthogonal to the others; sum its square and product with the residual.

    The image replaces the oldest one, which is read before.
    """
    c, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    last = count[env]
    q = load_chunk(image, c, env)
    for k in range(wp.max(last - WINDOW, 0), last):
        share = single(products[last, k, env] * inverse_squares[k, env])
        q -= share * load_chunk(images_out[k % WINDOW], c, env)
    store_chunk(directions_out[last], c, env, load_chunk(direction, c, env))
    store_chunk(images_out[last % WINDOW], c, env, q)
    wp.atomic_add(square_out, env, chunk_dot(q, q))
    wp.atomic_add(along_out, env, chunk_dot(q, load_chunk(residual, c, env)))


@wp.kernel
def advance_kernel(
    images: wp.array3d(dtype=wp.float32), square: Scalars, along: Scalars, count: Indices, active: Envs,
    # outputs
    inverse_squares_out: Vectors, steps_out: Vectors, residual_out: SingleVectors, residual_square_out: Scalars,
):
    """Subtract the residual's projection onto the last image; sum the squares of the new residual."""
    c, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    last = count[env]
    inverse = real(1.0) / square[env]
    step = single(along[env] * inverse)
    if c == 0:
        inverse_squares_out[last, env] = inverse
        steps_out[last, env] = along[env] * inverse
    r = load_chunk(residual_out, c, env) - step * load_chunk(images[last % WINDOW], c, env)
    store_chunk(residual_out, c, env, r)
    wp.atomic_add(residual_square_out, env, chunk_dot(r, r))


@wp.kernel
def select_unsolved_kernel(relative: Scalars, active: Envs, keep_out: Indices):
    """Keep systems whose residual is positive and finite."""
    lane = wp.tid()
    env = active[lane]
    if env >= 0:
        keep_out[lane] = int(relative[env] > real(0.0) and wp.isfinite(relative[env]))


@wp.kernel
def compact_kernel(
    keep: Indices, active: Envs, most: wp.int32,
    # outputs
    kept_out: Indices, iterations_out: Indices, unfinished_out: Indices,
):
    """Compact the list to the systems to keep, in order; another iteration follows if any is left, up to ``most``."""
    lane = wp.tid()
    before = wp.int32(0)
    total = wp.int32(0)
    for k in range(active.shape[0]):
        if active[k] < 0:
            break
        if k < lane:
            before += keep[k]
        total += keep[k]
    if lane >= total:
        kept_out[lane] = -1
    if active[lane] >= 0 and keep[lane] == 1:
        kept_out[before] = active[lane]
    if lane == 0:
        unfinished_out[0] = int(total > 0 and iterations_out[0] < most)
        iterations_out[0] = iterations_out[0] + 1


@wp.kernel
def check_convergence_kernel(
    residual_square: Scalars, tolerance: real, loose: real, size: wp.int32, iterations: Indices, together: wp.int32,
    active: Envs,
    # outputs
    count_out: Indices, stagnated_out: Indices, relative_out: Scalars, keep_out: Indices,
):
    """Keep systems whose residual is above their tolerance, or above `TIGHT` in the first ``together`` iterations.

    A system that breaks down ends with an infinite relative residual, or as it was if it had met its tolerance before.
    """
    lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    before = count_out[env]
    relative = wp.sqrt(residual_square[env])
    if not wp.isfinite(relative):
        if relative_out[env] > wp.where(before >= STRICT_ITERATIONS, loose, tolerance):
            relative_out[env] = real(wp.inf)
            count_out[env] = before + 1
        keep_out[lane] = 0
        return
    stagnated_out[env] = int(relative > real(STAGNATION) * relative_out[env])
    relative_out[env] = relative
    count_out[env] = before + 1
    goal = wp.where(before + 1 >= STRICT_ITERATIONS, loose, tolerance)
    if iterations[0] < together:
        goal = wp.min(goal, real(TIGHT))
    keep_out[lane] = int(relative > goal and before + 1 < size)


@wp.kernel
def seed_kernel(
    residual: SingleVectors, images: wp.array3d(dtype=wp.float32), inverse_squares: Vectors, count: Indices,
    stagnated: Indices, active: Envs,
    # outputs
    seed_out: SingleVectors,
):
    """Vector whose preconditioned form is the next direction: the residual, or the last image where it stagnated.

    The image is normalised: otherwise the images of many such steps overflow single precision.
    """
    c, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    if stagnated[env] == 1:
        last = count[env] - 1
        scale = single(wp.sqrt(inverse_squares[last, env]))
        store_chunk(seed_out, c, env, scale * load_chunk(images[last % WINDOW], c, env))
    else:
        store_chunk(seed_out, c, env, load_chunk(residual, c, env))


@wp.kernel
def substitute_kernel(
    products: wp.array3d(dtype=wp.float64), inverse_squares: Vectors, count: Indices, active: Envs,
    # outputs
    steps_out: Vectors,
):
    """Turn steps along the orthogonal images into steps along the directions, by back substitution."""
    env = active[wp.tid()]
    if env < 0:
        return
    for below in range(count[env]):
        j = count[env] - 1 - below
        for k in range(j):
            steps_out[k, env] = steps_out[k, env] - products[j, k, env] * inverse_squares[k, env] * steps_out[j, env]


@wp.kernel
def end_kernel(
    directions: wp.array3d(dtype=wp.float32), steps: Vectors, count: Indices, size: Scalars, active: Envs,
    # outputs
    x_out: Vectors,
):
    i, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    total = real(0.0)
    for k in range(count[env]):
        total += steps[k, env] * real(directions[k, i, env])
    x_out[i, env] = size[env] * total
