"""Sharing of the device by threads: one at a time launches kernels, and lets another in while it waits for results.

While a GPU computes the results of one thread, another thread launches its own kernels on another stream. Warp copies
with `array.numpy()`, and frees arrays, on CUDA's default stream, which waits for all others and makes all others wait.
Code that runs in every iteration therefore uses `read`, and arrays that are allocated once.
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


def launch_kernel(kernel: wp.Kernel, device, **arguments):
    """Launch a kernel in blocks of `BLOCK` threads: all kernels of a module, or Warp compiles it twice."""
    device = wp.get_device(device)
    wp.launch(kernel_for(kernel, device.is_cpu), device=device, block_dim=BLOCK, **arguments)


def read(*arrays) -> list[np.ndarray]:
    """Copy arrays of one device to the host; on a CPU these are views.

    Until the kernels launched before have ended, other threads may use the device, but not change this thread's arrays.
    """
    if DEVICE.mine:
        _wait_for(arrays[0].device)
    # `array.numpy()` would copy on CUDA's default stream, which waits for all streams, those of other threads too.
    return [array.to("cpu").numpy() for array in arrays]


def _wait_for(device: wp.Device):
    """Let others in until the kernels of this thread's stream have ended; on a CPU they have."""
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
    with wp.ScopedCapture(device=device) as recorded:
        yield recorded
