"""Environments are columns of all arrays: what is done to some of them, marked (env,) int32, while others stay."""

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
    i, env = wp.tid()
    if marked[env] != 0:
        copy_out[i, env] = source[i, env]


@wp.kernel
def clear_kernel(
    marked: wp.array(dtype=wp.int32),
    # outputs
    cleared_out: wp.array2d(dtype=Any),
):
    i, env = wp.tid()
    if marked[env] != 0:
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
    i, env = wp.tid()
    if marked[env] != 0:
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
    i, env = wp.tid()
    if marked[env] != 0:
        x_out[i, env] = start[i, env] + factor[env] * (start[i, env] - before[i, env])


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
