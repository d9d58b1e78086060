"""Arrays of a batch, one column for each environment, and operations that act on some of the columns.

`ActiveEnvironments` lists the environments that a kernel acts on: their numbers in order, then -1. Each thread looks up
its environment in this list. `launch` starts only as many threads as the list needs: otherwise a few environments would
take a GPU as long as all of them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from simgen.fem.device import read

wp.set_module_options({"enable_backward": False})

MANY = 4  # a list is long from this part of all environments on


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


for _kind in (wp.float64, wp.float32, wp.int32, wp.vec3d):  # a kind that came later would compile the module again
    wp.overload(copy_kernel, {"source": wp.array2d(dtype=_kind), "copy_out": wp.array2d(dtype=_kind)})
    wp.overload(clear_kernel, {"cleared_out": wp.array2d(dtype=_kind)})


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


class ActiveEnvironments:
    """The environments that kernels act in: all of them at first.

    numbers : (env,) int32 on the device, see `env_indices`. Kernels may shorten the list and leave ``lanes`` as it is
    lanes : threads for each row of a kernel: the number of environments. A GPU rounds it up to a power of two, which
        keeps the number of different graphs small
    """

    def __init__(self, n_env: int, device):
        self.numbers = wp.array(np.arange(n_env), dtype=wp.int32, device=device)
        self._factors = wp.zeros(n_env, dtype=wp.float64, device=device)
        self.device, self.shape, self.lanes = device, (n_env,), n_env
        self._exact = wp.get_device(device).is_cpu

    @classmethod
    def of(cls, environments: np.ndarray, device) -> ActiveEnvironments:
        """The list of the environments (env,) bool."""
        made = cls(len(environments), device)
        made.choose(environments)
        return made

    def __len__(self):
        return self.shape[0]

    def assign(self, numbers: np.ndarray):
        """Act in the environments of the list ``numbers`` (env,) from now on."""
        self.numbers.assign(numbers)
        count = max(int((numbers >= 0).sum()), 1)
        self.lanes = count if self._exact else min(1 << (count - 1).bit_length(), len(self))

    def choose(self, environments: np.ndarray):
        """Act in the environments (env,) bool from now on."""
        self.assign(env_indices(environments))

    def factors(self, values: np.ndarray) -> wp.array:
        """Numbers (env,) for the next kernel: always the same array, see `simgen.fem.device`."""
        self._factors.assign(values)
        return self._factors

    def numpy(self) -> np.ndarray:
        [numbers] = read(self.numbers)
        return numbers


def env_indices(environments: np.ndarray) -> np.ndarray:
    """Numbers of the environments (env,) bool in order, then -1: (env,) int32."""
    numbers = np.full(len(environments), -1, dtype=np.int32)
    chosen = np.flatnonzero(environments)
    numbers[: len(chosen)] = chosen
    return numbers


def env_mask(numbers: np.ndarray) -> np.ndarray:
    """Which environments (env,) bool a list (env,) has: the inverse of :func:`env_indices`."""
    environments = np.zeros(len(numbers), dtype=bool)
    environments[numbers[numbers >= 0]] = True
    return environments


def launch(kernel, rows: int | tuple[int, ...], inputs: list, outputs: list):
    """Launch a kernel over rows and the environments of the one `ActiveEnvironments` among its inputs."""
    [active] = [each for each in inputs if isinstance(each, ActiveEnvironments)]
    inputs = [each.numbers if each is active else each for each in inputs]
    rows = rows if isinstance(rows, tuple) else (rows,)
    wp.launch(kernel, dim=(*rows, active.lanes), inputs=inputs, outputs=outputs, device=active.device)


def _launch(kernel, inputs, out):
    launch(kernel, out.shape[0], inputs, [out])


def copy(source, marked, out):
    """out = source."""
    _launch(copy_kernel, [source, marked], out)


def clear(marked, out):
    """out = 0."""
    _launch(clear_kernel, [marked], out)


def reset(marked, out):
    """out = 0. Where many environments are listed, it fills the memory of all, which takes less time than a kernel."""
    if MANY * marked.lanes > len(marked):
        out.zero_()
    else:
        clear(marked, out)


def go_along(start, step, factor: np.ndarray, marked, out):
    """out = start + factor (env,) times step."""
    _launch(along_kernel, [start, step, marked.factors(factor), marked], out)


def go_beyond(before, start, factor: np.ndarray, marked, out):
    """out = start + factor (env,) times (start - before)."""
    _launch(beyond_kernel, [before, start, marked.factors(factor), marked], out)
