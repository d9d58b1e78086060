"""Environments are columns of all arrays: what is done to some of them while others stay.

Which, a list on the device says: their numbers in order, then -1 (`listed`). A kernel's threads look theirs up there,
so that those without work are whole warps, which end at once. With flags instead, a warp runs for any one of its 32
environments: on a GPU an iteration with an eighth of them active took as long as one with all.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def copy_kernel(
    source: wp.array2d(dtype=Any),
    marked: wp.array(dtype=wp.int32),
    # outputs
    copy_out: wp.array2d(dtype=Any),
):
    i, lane = wp.tid()
    env = marked[lane]
    if env >= 0:
        copy_out[i, env] = source[i, env]


@wp.kernel
def clear_kernel(
    marked: wp.array(dtype=wp.int32),
    # outputs
    cleared_out: wp.array2d(dtype=Any),
):
    i, lane = wp.tid()
    env = marked[lane]
    if env >= 0:
        cleared_out[i, env] = cleared_out.dtype(0.0)


@wp.kernel
def along_kernel(
    start: wp.array2d(dtype=wp.float64),
    step: wp.array2d(dtype=wp.float64),
    factor: wp.array(dtype=wp.float64),
    marked: wp.array(dtype=wp.int32),
    # outputs
    x_out: wp.array2d(dtype=wp.float64),
):
    i, lane = wp.tid()
    env = marked[lane]
    if env >= 0:
        x_out[i, env] = start[i, env] + factor[env] * step[i, env]


@wp.kernel
def beyond_kernel(
    before: wp.array2d(dtype=wp.float64),
    start: wp.array2d(dtype=wp.float64),
    factor: wp.array(dtype=wp.float64),
    marked: wp.array(dtype=wp.int32),
    # outputs
    x_out: wp.array2d(dtype=wp.float64),
):
    i, lane = wp.tid()
    env = marked[lane]
    if env >= 0:
        x_out[i, env] = start[i, env] + factor[env] * (start[i, env] - before[i, env])


def listed(environments: np.ndarray) -> np.ndarray:
    """Numbers of the environments (env,) bool in order, then -1: (env,) int32."""
    numbers = np.full(len(environments), -1, dtype=np.int32)
    chosen = np.flatnonzero(environments)
    numbers[: len(chosen)] = chosen
    return numbers


def unlisted(numbers: np.ndarray) -> np.ndarray:
    """Which environments (env,) bool a list (env,) has: the inverse of :func:`listed`."""
    environments = np.zeros(len(numbers), dtype=bool)
    environments[numbers[numbers >= 0]] = True
    return environments


def all_of(n_env: int, device) -> wp.array:
    """The list of all environments."""
    return wp.array(np.arange(n_env), dtype=wp.int32, device=device)


def _launch(kernel, inputs, out):
    wp.launch(kernel, dim=out.shape, inputs=inputs, outputs=[out], device=out.device)


def copy(source, marked, out):
    """out = source."""
    _launch(copy_kernel, [source, marked], out)


def clear(marked, out):
    """out = 0."""
    _launch(clear_kernel, [marked], out)


def go_along(start, step, factor: np.ndarray, marked, out):
    """out = start + factor (env,) times step."""
    _launch(along_kernel, [start, step, wp.array(factor, dtype=wp.float64, device=out.device), marked], out)


def go_beyond(before, start, factor: np.ndarray, marked, out):
    """out = start + factor (env,) times (start - before)."""
    _launch(beyond_kernel, [before, start, wp.array(factor, dtype=wp.float64, device=out.device), marked], out)
