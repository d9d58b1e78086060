"""Sharing of the device by threads: one at a time launches kernels, and lets another in while it waits for results.

While a GPU computes the results of one thread, another thread launches its own kernels on another stream. Warp copies
with `array.numpy()`, and frees arrays, on CUDA's default stream, which waits for all others and makes all others wait.
Code that runs in every iteration therefore uses `read` and `write`, and arrays that are allocated once.

With few presses, or on a coarse mesh, Python takes longer than the kernels. So launches are recorded and repeated.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

import numpy as np
import warp as wp


class Queue:
    """Lock that serves threads in the order of their arrival; a plain lock may serve the same thread again."""

    def __init__(self):
        self._lock, self._turns = threading.Lock(), deque()
        self._owner, self._waits = None, 0

    def __enter__(self):
        turn = threading.Lock()
        turn.acquire()
        with self._lock:
            first = not self._turns
            self._turns.append(turn)
        if not first:
            turn.acquire()  # until the thread before releases the lock
        self._owner = threading.get_ident()

    def __exit__(self, *error):
        self._owner = None
        with self._lock:
            self._turns.popleft()
            if self._turns:
                self._turns[0].release()

    @property
    def mine(self) -> bool:
        """True for the thread that holds the lock."""
        return self._owner == threading.get_ident()

    @contextmanager
    def left(self) -> Iterator[None]:
        """Release the lock while this thread waits for the device."""
        with self._lock:
            self._waits += 1
        self.__exit__()
        try:
            yield
        finally:
            with self._lock:
                self._waits -= 1
            self.__enter__()

    def wait_for_others(self):
        """Wait until no other thread waits for the device: this one may then act on the whole device."""
        while self._waits:
            time.sleep(1e-4)


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


# Launches by kernel, threads and contents of their arguments. Warp takes 40 to 80 us of a core to check and convert the
# arguments of one, and 7 us to repeat it (AMD EPYC).
_LAUNCHES: dict[tuple, wp.Launch] = {}
_GRAPHS_UNDER_WAY: list = []  # devices of graphs that are being recorded
MOST_LAUNCHES = 10_000  # a scene has some hundreds; arguments that change each time must not fill the memory


def launch_kernel(kernel: wp.Kernel, device, dim, inputs: list, outputs: list):
    """Launch a kernel in blocks of `BLOCK` threads: all kernels of a module, or Warp compiles it twice.

    Arguments are arrays, structs and numbers.
    """
    if _GRAPHS_UNDER_WAY:  # on a CPU, a graph needs the arrays themselves
        _launch(kernel, device, dim, inputs, outputs)
        return
    key = (kernel, str(device), dim, *map(_content, inputs), *map(_content, outputs))
    launch = _LAUNCHES.get(key)
    if launch is None:
        launch = _record(kernel, device, dim, inputs, outputs)
        if launch is None:
            return
        if len(_LAUNCHES) >= MOST_LAUNCHES:
            _LAUNCHES.clear()
        _LAUNCHES[key] = launch
    launch.launch()


def _launch(kernel: wp.Kernel, device, dim, inputs: list, outputs: list, record: bool = False) -> wp.Launch | None:
    device = wp.get_device(device)
    kernel = kernel_for(kernel, device.is_cpu)
    return wp.launch(kernel, dim, inputs, outputs, device=device, block_dim=BLOCK, record_cmd=record)


def _content(argument):
    """What tells an argument from others: a number itself, type and descriptor of an array, all fields of a struct."""
    if isinstance(argument, wp.array):
        return argument.dtype, bytes(argument.__ctype__())
    describe = getattr(argument, "__ctype__", None)
    return argument if describe is None else bytes(describe())


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


class _HostArray:
    """Host memory from or to which an array is copied, and its view as a NumPy array."""

    def __init__(self, array: wp.array, pinned: bool):
        self.array = wp.zeros(array.shape, dtype=array.dtype, device="cpu", pinned=pinned)
        self.view = self.array.numpy()


# Host memory by shape and type. Pinned memory also by CUDA stream and place among the arrays that are read together.
_HOST: dict[tuple, _HostArray] = {}
LARGEST_PINNED = 1 << 13  # elements: of larger arrays, the copy itself takes longest
_EVENTS: dict[tuple, wp.Event] = {}  # by device and CUDA stream: its kernels and copies have ended


def _host(array: wp.array, *place: int) -> _HostArray:
    """Host memory for an array, always the same for the same place; pinned if a place is given."""
    key = (array.shape, array.dtype, *place)
    if key not in _HOST:
        _HOST[key] = _HostArray(array, pinned=bool(place))
    return _HOST[key]


def write(values: np.ndarray, array: wp.array):
    """Copy values from the host to an array, before kernels that are launched later.

    `array.assign` would first make a Warp array of the values.
    """
    if array.device.is_cpu:
        array.numpy()[...] = values
        return
    host = _host(array)
    host.view[...] = values
    wp.copy(array, host.array)  # CUDA has taken the values when this returns, because the memory is not pinned


def read(*arrays: wp.array) -> list[np.ndarray]:
    """Copy arrays of one device to the host.

    Until the kernels launched before have ended, other threads may use the device, but not change this thread's arrays.
    """
    device = arrays[0].device
    begun = [_begin_read(array, place) for place, array in enumerate(arrays)]
    if DEVICE.mine:
        _wait_for(device)
    elif device.is_cuda:
        wp.synchronize_stream(device.stream)
    return [_end_read(array, host) for array, host in zip(arrays, begun, strict=True)]


def _begin_read(array: wp.array, place: int) -> _HostArray | None:
    """Begin to copy a small array of a GPU; None for others."""
    if array.device.is_cpu or array.size > LARGEST_PINNED:
        return None
    host = _host(array, array.device.stream.cuda_stream, place)
    wp.copy(host.array, array)
    return host


def _end_read(array: wp.array, host: _HostArray | None) -> np.ndarray:
    if host is not None:
        return host.view.copy()
    if array.device.is_cpu:
        return array.numpy().copy()
    # `array.numpy()` would copy on CUDA's default stream, which waits for all streams, those of other threads too.
    return array.to("cpu").numpy()


def _wait_for(device: wp.Device):
    """Let others in until this thread's stream has done its kernels and copies; on a CPU they are done."""
    if device.is_cpu:
        return
    stream = device.stream
    place = str(device), stream.cuda_stream
    if place not in _EVENTS:
        _EVENTS[place] = wp.Event(device)
    event = stream.record_event(_EVENTS[place])
    with DEVICE.left():
        wp.synchronize_event(event)
    wp.set_stream(stream, device)  # others have set their own


@contextmanager
def recording(device) -> Iterator[wp.ScopedCapture]:
    """Record the kernels that are launched inside as a graph. No thread may wait for the device meanwhile."""
    DEVICE.wait_for_others()
    _GRAPHS_UNDER_WAY.append(device)
    try:
        with wp.ScopedCapture(device=device) as recorded:
            yield recorded
    finally:
        _GRAPHS_UNDER_WAY.pop()
