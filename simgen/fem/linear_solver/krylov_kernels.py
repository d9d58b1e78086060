"""What conjugate residuals (see ``krylov``) do to vectors (n, env), in the environments that are active."""

from __future__ import annotations

from typing import Any

import warp as wp

from simgen.fem.material.neo_hookean import real, single
from simgen.fem.sections import CHUNK, product, store_terms, terms

wp.set_module_options({"enable_backward": False})

STUCK = 0.9  # of the last residual: one that shrinks less says little that is new
# Images that a new one is made orthogonal to, the last ones (Vinsome's Orthomin, SPE 5729, 1976). To a tolerance of 0.1
# even 6 are enough (4 % more iterations under a cube 1.6 mm deep, none more elsewhere), to 1e-5 8 are too few.
WINDOW = 16
SOON = 4  # iterations after which a looser tolerance holds
TOGETHER = 4  # images that one thread multiplies a new one with: most systems have no more


@wp.kernel
def dots_kernel(
    a: wp.array2d(dtype=Any),
    b: wp.array2d(dtype=Any),
    active: wp.array(dtype=wp.int32),
    # outputs
    products_out: wp.array(dtype=wp.float64),
):
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
def begin_kernel(
    b: wp.array2d(dtype=wp.float64),
    squares: wp.array(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    # outputs
    residual_out: wp.array2d(dtype=wp.float32),
    size_out: wp.array(dtype=wp.float64),
    count_out: wp.array(dtype=wp.int32),
    relative_out: wp.array(dtype=wp.float64),
    stuck_out: wp.array(dtype=wp.int32),
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
        stuck_out[env] = 0


@wp.kernel
def clear_kernel(
    count: wp.array(dtype=wp.int32),
    active: wp.array(dtype=wp.int32),
    # outputs
    products_out: wp.array3d(dtype=wp.float64),
    square_out: wp.array(dtype=wp.float64),
    along_out: wp.array(dtype=wp.float64),
    left_out: wp.array(dtype=wp.float64),
):
    env = active[wp.tid()]
    if env < 0:
        return
    last = count[env]
    for k in range(last):
        products_out[last, k, env] = real(0.0)
    square_out[env] = real(0.0)
    along_out[env] = real(0.0)
    left_out[env] = real(0.0)


@wp.kernel
def project_kernel(
    images: wp.array3d(dtype=wp.float32),
    image: wp.array2d(dtype=wp.float32),
    count: wp.array(dtype=wp.int32),
    active: wp.array(dtype=wp.int32),
    # outputs
    products_out: wp.array3d(dtype=wp.float64),
):
    """Inner products of the new image with the last ones before it, some of them by each thread."""
    c, group, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    last = count[env]
    if last <= group * TOGETHER:
        return
    new = terms(image, c, env)
    for back in range(TOGETHER):
        k = last - 1 - group * TOGETHER - back
        if k >= 0:
            wp.atomic_add(products_out, last, k, env, product(terms(images[k % WINDOW], c, env), new))


@wp.kernel
def orthogonalize_kernel(
    direction: wp.array2d(dtype=wp.float32),
    image: wp.array2d(dtype=wp.float32),
    residual: wp.array2d(dtype=wp.float32),
    products: wp.array3d(dtype=wp.float64),
    inverse_squares: wp.array2d(dtype=wp.float64),
    count: wp.array(dtype=wp.int32),
    active: wp.array(dtype=wp.int32),
    # outputs
    directions_out: wp.array3d(dtype=wp.float32),
    images_out: wp.array3d(dtype=wp.float32),
    square_out: wp.array(dtype=wp.float64),
    along_out: wp.array(dtype=wp.float64),
):
    """Keep the direction, and of its image what is new: its square, and its product with the residual.

    The oldest image makes room: its row is read before it is written.
    """
    c, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    last = count[env]
    q = terms(image, c, env)
    for k in range(wp.max(last - WINDOW, 0), last):
        share = single(products[last, k, env] * inverse_squares[k, env])
        q -= share * terms(images_out[k % WINDOW], c, env)
    store_terms(directions_out[last], c, env, terms(direction, c, env))
    store_terms(images_out[last % WINDOW], c, env, q)
    wp.atomic_add(square_out, env, product(q, q))
    wp.atomic_add(along_out, env, product(q, terms(residual, c, env)))


@wp.kernel
def advance_kernel(
    images: wp.array3d(dtype=wp.float32),
    square: wp.array(dtype=wp.float64),
    along: wp.array(dtype=wp.float64),
    count: wp.array(dtype=wp.int32),
    active: wp.array(dtype=wp.int32),
    # outputs
    inverse_squares_out: wp.array2d(dtype=wp.float64),
    steps_out: wp.array2d(dtype=wp.float64),
    residual_out: wp.array2d(dtype=wp.float32),
    left_out: wp.array(dtype=wp.float64),
):
    """Take from the residual what the last image has of it; squares of what is left."""
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
    r = terms(residual_out, c, env) - step * terms(images[last % WINDOW], c, env)
    store_terms(residual_out, c, env, r)
    wp.atomic_add(left_out, env, product(r, r))


@wp.kernel
def rest_kernel(
    relative: wp.array(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    # outputs
    keep_out: wp.array(dtype=wp.int32),
):
    """Systems of which nothing is left, or nothing to be had, rest."""
    lane = wp.tid()
    env = active[lane]
    if env >= 0:
        keep_out[lane] = int(relative[env] > real(0.0) and wp.isfinite(relative[env]))


@wp.kernel
def close_ranks_kernel(
    keep: wp.array(dtype=wp.int32),
    active: wp.array(dtype=wp.int32),
    most: wp.int32,
    # outputs
    kept_out: wp.array(dtype=wp.int32),
    ticks_out: wp.array(dtype=wp.int32),
    going_out: wp.array(dtype=wp.int32),
):
    """The list of those to keep, in order; whether another iteration follows, if ``most`` are wanted."""
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
        going_out[0] = int(total > 0 and ticks_out[0] < most)
        ticks_out[0] = ticks_out[0] + 1


@wp.kernel
def judge_kernel(
    left: wp.array(dtype=wp.float64),
    tolerance: real,
    later: real,
    exact: real,
    size: wp.int32,
    active: wp.array(dtype=wp.int32),
    # outputs
    count_out: wp.array(dtype=wp.int32),
    stuck_out: wp.array(dtype=wp.int32),
    relative_out: wp.array(dtype=wp.float64),
    keep_out: wp.array(dtype=wp.int32),
):
    """Which systems go on: until their tolerance, or until they are ``exact`` if that is less.

    One that has broken down does not, its relative residual is infinite; if it had met its tolerance before, it rests
    as it was.
    """
    lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    before = count_out[env]
    relative = wp.sqrt(left[env])
    if not wp.isfinite(relative):
        if relative_out[env] > wp.where(before >= SOON, later, tolerance):
            relative_out[env] = real(wp.inf)
            count_out[env] = before + 1
        keep_out[lane] = 0
        return
    stuck_out[env] = int(relative > real(STUCK) * relative_out[env])
    relative_out[env] = relative
    count_out[env] = before + 1
    goal = wp.min(wp.where(before + 1 >= SOON, later, tolerance), exact)
    keep_out[lane] = int(relative > goal and before + 1 < size)


@wp.kernel
def source_kernel(
    residual: wp.array2d(dtype=wp.float32),
    images: wp.array3d(dtype=wp.float32),
    inverse_squares: wp.array2d(dtype=wp.float64),
    count: wp.array(dtype=wp.int32),
    stuck: wp.array(dtype=wp.int32),
    active: wp.array(dtype=wp.int32),
    # outputs
    source_out: wp.array2d(dtype=wp.float32),
):
    """The vector that the next direction is made of: the residual, or the last image.

    An image is normalised, or the images of many such steps overflow single precision.
    """
    c, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    if stuck[env] == 1:
        last = count[env] - 1
        scale = single(wp.sqrt(inverse_squares[last, env]))
        store_terms(source_out, c, env, scale * terms(images[last % WINDOW], c, env))
    else:
        store_terms(source_out, c, env, terms(residual, c, env))


@wp.kernel
def substitute_kernel(
    products: wp.array3d(dtype=wp.float64),
    inverse_squares: wp.array2d(dtype=wp.float64),
    count: wp.array(dtype=wp.int32),
    active: wp.array(dtype=wp.int32),
    # outputs
    steps_out: wp.array2d(dtype=wp.float64),
):
    """From steps along the images that were kept to steps along the directions: image j was that of direction j without
    the shares of those before it.
    """
    env = active[wp.tid()]
    if env < 0:
        return
    for below in range(count[env]):
        j = count[env] - 1 - below
        for k in range(j):
            steps_out[k, env] = steps_out[k, env] - products[j, k, env] * inverse_squares[k, env] * steps_out[j, env]


@wp.kernel
def end_kernel(
    directions: wp.array3d(dtype=wp.float32),
    steps: wp.array2d(dtype=wp.float64),
    count: wp.array(dtype=wp.int32),
    size: wp.array(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    # outputs
    x_out: wp.array2d(dtype=wp.float64),
):
    i, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    total = real(0.0)
    for k in range(count[env]):
        total += steps[k, env] * real(directions[k, i, env])
    x_out[i, env] = size[env] * total
