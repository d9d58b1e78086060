"""Sharing of the device by threads: one at a time launches kernels, and lets another in while it waits for results.

A thread also lets another in between two launches, if the other one's rank is lower: see `Pool.device_rank`.

While a GPU computes the results of one thread, another thread launches its own kernels on another stream. Warp copies
with `array.numpy()`, and frees arrays, on CUDA's default stream, which waits for all others and makes all others wait.
Code that runs in every iteration therefore uses `read` and `write`, and arrays that are allocated once.

With few presses, or on a coarse mesh, Python takes longer than the kernels. So launches are recorded and repeated.
"""

from __future__ import annotations

import ctypes
import struct
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Any

import numpy as np
import warp as wp

from simgen.fem.turns import Queue

DEVICE = Queue()

# Threads of a GPU's block. With 256, Warp's default, a round of 512 presses took 81.7 ms instead of 77.3 (one H100,
# measured once).
BLOCK = 128


def large_kernel(
    function: Callable | None = None, cpu_module: wp.Module | None = None, **options
) -> wp.Kernel | Callable[[Callable], wp.Kernel]:
    """Make a kernel that takes a second or more to compile; a decorator, with or without arguments.

    For GPUs it is a module of its own, because modules are compiled in parallel. A CPU has few cores, which would
    compile the functions that several kernels share again for each. For CPUs all large kernels of a package are
    therefore one module, or belong to ``cpu_module``.
    """
    if function is None:
        return partial(large_kernel, cpu_module=cpu_module, **options)
    kernel = wp.kernel(function, module="unique", enable_backward=False, **options)
    module = cpu_module or f"{function.__module__.rpartition('.')[0]}.cpu"
    kernel.on_cpu = wp.kernel(function, module=module, enable_backward=False)
    return kernel


def kernel_for(kernel: wp.Kernel, cpu: bool) -> wp.Kernel:
    """The kernel that a CPU, or a GPU, launches: a `large_kernel` exists twice."""
    return getattr(kernel, "on_cpu", kernel) if cpu else kernel


DRIVER = "nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1"


def stream_in_place(device: wp.Device, place: int) -> wp.Stream:
    """Make a stream whose kernels start before those of streams in later places, from 0 on. It is never destroyed.

    Warp knows two priorities, CUDA has more: six on an H200. All later places share the last one. Raises `RuntimeError`
    if CUDA makes no stream.
    """
    device.make_current()
    driver, handle = ctypes.CDLL(DRIVER), ctypes.c_void_p()
    last, first = ctypes.c_int(), ctypes.c_int()
    error = driver.cuCtxGetStreamPriorityRange(ctypes.byref(last), ctypes.byref(first))
    error = error or driver.cuStreamCreateWithPriority(ctypes.byref(handle), 0, min(first.value + place, last.value))
    if error:
        raise RuntimeError(f"{device}: CUDA cannot make a stream (error {error} of cuStreamCreateWithPriority)")
    return wp.Stream(device, cuda_stream=handle.value)


# Recorded launches by kernel, threads and arguments. Warp takes 40 to 80 us of a core to check and convert a launch's
# arguments, and 7 us to repeat it (AMD EPYC).
_LAUNCHES: dict[tuple, wp.Launch] = {}
MOST_LAUNCHES = 10_000  # a scene has some hundreds; arguments that change each time must not fill the memory
_ONCE: list[None] = []  # an entry for each `once` under way


def launch_kernel(kernel: wp.Kernel, device, dim, inputs: list, outputs: list):
    """Launch a kernel in blocks of `BLOCK` threads: all kernels of a module, or Warp compiles it twice.

    The launch is recorded, and repeated when the same arguments come again. Arguments are arrays, structs and numbers.
    """
    if _ONCE:
        _launch(kernel, device, dim, inputs, outputs)
        return
    if DEVICE.delays_others:
        _step_aside(wp.get_device(device))
    key = (kernel, str(device), dim, *map(_key, inputs), *map(_key, outputs))
    launch = _LAUNCHES.get(key)
    if launch is None:
        launch = _record(kernel, device, dim, inputs, outputs)
        if launch is None:
            return
        if len(_LAUNCHES) >= MOST_LAUNCHES:
            _LAUNCHES.clear()
        _LAUNCHES[key] = launch
    launch.launch()


def _step_aside(device: wp.Device):
    stream = device.stream if device.is_cuda else None
    DEVICE.step_aside()
    if stream is not None:
        wp.set_stream(stream, device)  # others have set their own


@contextmanager
def once() -> Iterator[None]:
    """Do not record the launches inside: they belong to a graph, or do not come again."""
    _ONCE.append(None)
    try:
        yield
    finally:
        _ONCE.pop()


def _launch(kernel: wp.Kernel, device, dim, inputs: list, outputs: list, record: bool = False) -> wp.Launch | None:
    device = wp.get_device(device)
    kernel = kernel_for(kernel, device.is_cpu)
    return wp.launch(kernel, dim, inputs, outputs, device=device, block_dim=BLOCK, record_cmd=record)


def _key(argument):
    """Key of an argument: the number, the type and descriptor of an array, or the type and fields of a struct."""
    if isinstance(argument, wp.array):
        try:
            return argument.launch_key
        except AttributeError:  # no array changes its memory, and none has gradients
            argument.launch_key = argument.dtype, bytes(argument.__ctype__())
            return argument.launch_key
    if isinstance(argument, float):  # nan differs from itself, and -0 equals 0
        return struct.pack("d", argument)
    describe = getattr(argument, "__ctype__", None)
    return argument if describe is None else (type(argument), bytes(describe()))


def _record(kernel: wp.Kernel, device, dim, inputs: list, outputs: list) -> wp.Launch | None:
    """Record a launch; None for one without threads."""
    launch = _launch(kernel, device, dim, inputs, outputs, record=True)
    if launch is None:
        return None
    for i, argument in enumerate([*inputs, *outputs]):
        if hasattr(argument, "__ctype__") and not isinstance(argument, wp.array):  # a struct, whose fields may change
            fields = argument.__ctype__()
            launch.set_param_at_index_from_ctype(i, type(fields).from_buffer_copy(fields))
    launch.fwd_args = None  # it would keep the memory of arrays
    return launch


class _HostMemory:
    """Memory of the host through which arrays of a GPU are copied, pinned or not."""

    BYTES = 1 << 18  # copies of larger arrays take longer than Warp's preparations for them

    def __init__(self, pinned: bool):
        self._memory = wp.empty(self.BYTES, dtype=wp.uint8, device="cpu", pinned=pinned)
        self._pinned, self._views = pinned, {}

    def view(self, array: wp.array) -> tuple[wp.array, np.ndarray]:
        """The first part of the memory as a Warp array with the shape and type of another, and as a NumPy array."""
        key = array.shape, array.dtype
        if key not in self._views:
            place = {"ptr": self._memory.ptr, "device": "cpu", "pinned": self._pinned}
            same = wp.array(shape=array.shape, dtype=array.dtype, **place)
            self._views[key] = same, same.numpy()
        return self._views[key]

    @classmethod
    def holds(cls, array: wp.array) -> bool:
        return array.size * wp.types.type_size_in_bytes(array.dtype) <= cls.BYTES


# Memory that no thread uses at present. Each copy has its own, so threads and streams cannot disturb each other.
_FREE: dict[bool, list[_HostMemory]] = {True: [], False: []}


def _take(pinned: bool) -> _HostMemory:
    try:
        return _FREE[pinned].pop()
    except IndexError:
        return _HostMemory(pinned)


def write(values: np.ndarray, array: wp.array):
    """Copy values from the host to an array, before kernels that are launched later.

    Values are broadcast to the array's shape. `array.assign` would first make a Warp array of them.
    """
    if array.device.is_cpu:
        np.copyto(array.numpy(), values, casting="same_kind")
    elif not _HostMemory.holds(array):
        array.assign(np.broadcast_to(values, array.shape))
    else:
        memory = _take(pinned=False)
        same, view = memory.view(array)
        np.copyto(view, values, casting="same_kind")
        wp.copy(array, same)  # CUDA has taken the values when this returns, because the memory is not pinned
        _FREE[False].append(memory)


def read(*arrays: wp.array) -> list[np.ndarray]:
    """Copy arrays of one device to the host.

    Until the kernels launched before have ended, other threads may use the device, but not change this thread's arrays.
    """
    if not arrays:
        return []
    device = arrays[0].device
    begun = [_begin_read(array) for array in arrays]
    if DEVICE.mine:
        _wait_for(device)
    elif device.is_cuda:
        wp.synchronize_device(device)
    return [_end_read(array, memory) for array, memory in zip(arrays, begun, strict=True)]


@dataclass(frozen=True)
class Reading:
    """A value that the device computes.

    arrays : launched kernels fill them
    value : makes the value of their contents
    """

    arrays: tuple[wp.array, ...]
    value: Callable[..., Any]

    def read(self) -> Any:
        """Return the value."""
        return self.value(*read(*self.arrays))


def read_together(*readings: Reading) -> list[Any]:
    """Return the values of readings. The host waits for the device once, not once for each."""
    return combined(readings, lambda *values: list(values)).read()


def combined(readings: Sequence[Reading], value: Callable[..., Any]) -> Reading:
    """Make one reading of several, whose value is made of their values."""
    arrays = tuple(array for reading in readings for array in reading.arrays)

    def made(*contents: np.ndarray) -> Any:
        left = iter(contents)
        return value(*(reading.value(*islice(left, len(reading.arrays))) for reading in readings))

    return Reading(arrays, made)


def _begin_read(array: wp.array) -> _HostMemory | None:
    """Begin to copy a small array of a GPU; None for others."""
    if array.device.is_cpu or not _HostMemory.holds(array):
        return None
    memory = _take(pinned=True)
    wp.copy(memory.view(array)[0], array)
    return memory


def _end_read(array: wp.array, memory: _HostMemory | None) -> np.ndarray:
    if memory is not None:
        found = memory.view(array)[1].copy()
        _FREE[True].append(memory)
        return found
    if array.device.is_cpu:
        return array.numpy().copy()
    # `array.numpy()` would copy on CUDA's default stream, which waits for all streams, those of other threads too.
    return array.to("cpu").numpy()


def _wait_for(device: wp.Device):
    """Let others in until this thread's stream has done its kernels and copies; on a CPU they are done."""
    if device.is_cpu:
        return
    stream = device.stream
    event = stream.record_event()
    with DEVICE.left():
        wp.synchronize_event(event)
    wp.set_stream(stream, device)  # others have set their own


@contextmanager
def recording(device) -> Iterator[wp.ScopedCapture]:
    """Record the kernels that are launched inside as a graph. No thread may wait for the device meanwhile."""
    DEVICE.wait_for_others()
    with once(), wp.ScopedCapture(device=device) as recorded:  # on a CPU, a graph needs the arrays themselves
        yield recorded
