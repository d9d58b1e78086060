"""Arrays of a batch, one column for each environment, and operations on the columns of active environments.

`ActiveEnvironments` lists the environments that a kernel acts on: their numbers in order, then -1. Each thread looks up
its environment in this list. `launch` starts only as many threads as the list needs: otherwise a GPU would take as long
for a few environments as for all.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from simgen.fem.device import launch_kernel, read, write

wp.set_module_options({"enable_backward": False})

# Types of kernels' arguments
Vectors, SingleVectors = wp.array2d(dtype=wp.float64), wp.array2d(dtype=wp.float32)  # (row, env)
Scalars, Indices = wp.array(dtype=wp.float64), wp.array(dtype=wp.int32)  # one for each environment or row
Envs = Indices  # numbers of the active environments, see `ActiveEnvironments`
IndexTable = wp.array2d(dtype=wp.int32)

FEW = 4  # few environments are active if their number times FEW is at most the number of all
# With at most so many, several threads of a GPU share a long sum. Measured with 1 and 4 presses (host_h200.json), the
# sums of the smoother with 1 to 32 (damping_h200.json).
FEW_LANES = 32


@wp.kernel
def copy_kernel(source: wp.array2d(dtype=Any), active: Envs, copy_out: wp.array2d(dtype=Any)):
    i, lane = wp.tid()
    env = active[lane]
    if env >= 0:
        copy_out[i, env] = source[i, env]


@wp.kernel
def clear_kernel(active: Envs, cleared_out: wp.array2d(dtype=Any)):
    i, lane = wp.tid()
    env = active[lane]
    if env >= 0:
        cleared_out[i, env] = cleared_out.dtype(0.0)


@wp.kernel
def move_kernel(pairs: IndexTable, moved_out: wp.array2d(dtype=Any)):
    """``pairs`` (2, env): the numbers of columns, and of those to which they are copied; -1 for no column."""
    i, k = wp.tid()
    if pairs[0, k] >= 0:
        moved_out[i, pairs[1, k]] = moved_out[i, pairs[0, k]]


for _kind in (wp.float64, wp.float32, wp.int32, wp.vec3d):  # a type added later would compile the module again
    wp.overload(copy_kernel, {"source": wp.array2d(dtype=_kind), "copy_out": wp.array2d(dtype=_kind)})
    wp.overload(clear_kernel, {"cleared_out": wp.array2d(dtype=_kind)})
for _kind in (wp.float64, wp.float32, wp.int32, wp.vec3d, wp.mat33d):
    wp.overload(move_kernel, {"moved_out": wp.array2d(dtype=_kind)})


@wp.kernel
def add_scaled_kernel(start: Vectors, step: Vectors, factor: Scalars, active: Envs, x_out: Vectors):
    i, lane = wp.tid()
    env = active[lane]
    if env >= 0:
        x_out[i, env] = start[i, env] + factor[env] * step[i, env]


@wp.kernel
def extrapolate_kernel(before: Vectors, start: Vectors, factor: Scalars, active: Envs, x_out: Vectors):
    i, lane = wp.tid()
    env = active[lane]
    if env >= 0:
        x_out[i, env] = start[i, env] + factor[env] * (start[i, env] - before[i, env])


class ActiveEnvironments:
    """List of the environments that kernels act in: all of them at first.

    numbers : (env,) int32 on the device, see `env_indices`. Kernels may shorten the list without changing ``lanes``:
        see :meth:`shortened`
    chosen : (env,) bool, environments of the list before kernels shortened it
    lanes : threads for each row of a kernel: the number of environments, on a GPU rounded up to a power of two, which
        keeps the number of different graphs small
    """

    def __init__(self, n_env: int, device):
        self.numbers = wp.array(np.arange(n_env), dtype=wp.int32, device=device)
        self._factors = wp.zeros(n_env, dtype=wp.float64, device=device)
        self._pairs = wp.zeros((2, n_env), dtype=wp.int32, device=device)
        self.device, self.shape, self.lanes, self.chosen = device, (n_env,), n_env, np.ones(n_env, dtype=bool)
        self._exact, self._whole = wp.get_device(device).is_cpu, False  # _whole: the device has the list of ``chosen``

    @classmethod
    def of(cls, environments: np.ndarray, device) -> ActiveEnvironments:
        """List the environments (env,) bool."""
        made = cls(len(environments), device)
        made.choose(environments)
        return made

    def __len__(self):
        return self.shape[0]

    @property
    def few(self) -> bool:
        """True on a GPU if kernels act in at most `FEW_LANES` environments.

        Always False on a CPU, where the order of sums must not depend on their number.
        """
        return self.lanes <= FEW_LANES and not self._exact

    def assign(self, numbers: np.ndarray):
        """Act in the environments of the list ``numbers`` (env,) from now on."""
        self._assign(numbers, env_mask(numbers))

    def choose(self, environments: np.ndarray):
        """Act in the environments (env,) bool from now on."""
        if self._whole and np.array_equal(environments, self.chosen):
            return
        self._assign(env_indices(environments), environments.astype(bool))
        self._whole = True

    def shortened(self):
        """Note that kernels have shortened the list on the device."""
        self._whole = False

    def _assign(self, numbers: np.ndarray, chosen: np.ndarray):
        self._whole = False
        write(numbers, self.numbers)
        self.chosen, count = chosen, max(int(np.count_nonzero(chosen)), 1)
        self.lanes = count if self._exact else self.rounded_up(count)

    def rounded_up(self, count: int) -> int:
        """The next power of two, but at most the number of environments."""
        return min(1 << (count - 1).bit_length(), len(self))

    def factors(self, values: np.ndarray) -> wp.array:
        """Copy values (env,) to the device for the next kernel, always into the same array, see `simgen.fem.device`."""
        write(values, self._factors)
        return self._factors

    def pairs(self, sources: np.ndarray, targets: np.ndarray) -> wp.array:
        """Copy environments' numbers (k,) to the device in the same way: (2, env), with -1 behind them."""
        pairs = np.full(self._pairs.shape, -1, dtype=np.int32)
        pairs[:, : len(sources)] = sources, targets
        write(pairs, self._pairs)
        return self._pairs

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
    """Environments (env,) bool of a list (env,) of numbers: the inverse of :func:`env_indices`."""
    environments = np.zeros(len(numbers), dtype=bool)
    environments[numbers[numbers >= 0]] = True
    return environments


def launch(kernel, rows: int | tuple[int, ...], inputs: list, outputs: list, whole_rows: bool = False):
    """Launch a kernel over rows and the environments of the one `ActiveEnvironments` among its inputs.

    whole_rows : a thread runs over all environments of a row by itself
    """
    [active] = [each for each in inputs if isinstance(each, ActiveEnvironments)]
    inputs = [each.numbers if each is active else each for each in inputs]
    rows = rows if isinstance(rows, tuple) else (rows,)
    dim = rows if whole_rows else (*rows, active.lanes)
    launch_kernel(kernel, dim=dim, inputs=inputs, outputs=outputs, device=active.device)


def copy(source, active, out):
    """out = source."""
    launch(copy_kernel, len(out), [source, active], [out])


def clear(active, out):
    """out = 0."""
    launch(clear_kernel, len(out), [active], [out])


def reset(active, out):
    """out = 0, in all environments unless few are active: filling all memory is faster than a kernel."""
    if FEW * active.lanes > len(active):
        out.zero_()
    else:
        clear(active, out)


def move(arrays, active: ActiveEnvironments, sources: np.ndarray, targets: np.ndarray, kernel: wp.Kernel = move_kernel):
    """Copy the columns of the environments numbered ``sources`` (k,) to those numbered ``targets`` (k,).

    kernel : for arrays of another shape; its threads run over the arrays' second last axis and the pairs
    """
    pairs = active.pairs(sources, targets)
    for array in arrays:
        dim = array.shape[-2], active.rounded_up(len(sources))  # a power of two, so that few launches are recorded
        launch_kernel(kernel, dim=dim, inputs=[pairs], outputs=[array], device=active.device)


def lower_columns(movable: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (k,) of ``movable`` environments (env,) bool, highest first, and of ``free`` ones with lower numbers."""
    pairs = zip(np.flatnonzero(movable)[::-1], np.flatnonzero(free), strict=False)
    pairs = np.array(list(pairs), dtype=int).reshape(-1, 2)
    return tuple(pairs[pairs[:, 0] > pairs[:, 1]].T)


def add_scaled(start, step, factor: np.ndarray, active, out):
    """out = start + factor (env,) times step."""
    launch(add_scaled_kernel, len(out), [start, step, active.factors(factor), active], [out])


def extrapolate(before, start, factor: np.ndarray, active, out):
    """out = start + factor (env,) times (start - before)."""
    launch(extrapolate_kernel, len(out), [before, start, active.factors(factor), active], [out])
