"""Threads of a process share its device: one at a time gives it work, and lets another in while it waits for results.

A GPU works on its own. While it makes what one thread waits for, another thread prepares its own kernels, which run on
another stream. Warp copies with `array.numpy()`, and frees arrays, on CUDA's default stream, which waits for all others
and lets all others wait. So what is done in every iteration uses `read`, and arrays that are made once.
"""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

import numpy as np
import warp as wp


class Queue:
    """A lock that lets threads in by turns, first come, first served; a plain one may keep to the same thread."""

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
            turn.acquire()  # until the one before lets go
        self._owner = threading.get_ident()

    def __exit__(self, *error):
        self._owner = None
        with self._lock:
            self._turns.popleft()
            if self._turns:
                self._turns[0].release()

    @property
    def mine(self) -> bool:
        """True for the thread that is in."""
        return self._owner == threading.get_ident()

    @contextmanager
    def left(self) -> Iterator[None]:
        """Let other threads in for as long as this one, which is in, waits for the device."""
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
        """Wait until no other thread waits for the device. This one may then do what concerns all of it."""
        while self._waits:
            time.sleep(1e-4)


DEVICE = Queue()

# A kernel that takes a second or more to compile is a module of its own: one core compiles a module of Warp, and
# `load_kernels` compiles as many at once as there are cores.
large_kernel = partial(wp.kernel, module="unique", enable_backward=False)


def load_kernels(device: str):
    """Compile the kernels of all modules that are imported for a GPU, as many modules at once as there are cores.

    Warp would compile each one when a kernel of it is first launched, one after the other.
    """
    if not wp.get_device(device).is_cpu:
        wp.force_load(device, max_workers=os.cpu_count())


def read(*arrays) -> list[np.ndarray]:
    """The values of arrays on one device. Until the kernels before have ended, other threads may use the device.

    They must not change what this thread works on. On a CPU these are views.
    """
    if DEVICE.mine:
        _wait_for(arrays[0].device)
    # `array.numpy()` would copy on CUDA's default stream, which waits for all streams, those of other threads too.
    return [array.to("cpu").numpy() for array in arrays]


def _wait_for(device: wp.Device):
    """Let others in until the kernels of this thread's stream have ended. A CPU has done them when they are launched.
    """
    if device.is_cpu:
        return
    stream = device.stream
    event = stream.record_event()
    with DEVICE.left():
        wp.synchronize_event(event)
    wp.set_stream(stream, device)  # others have set their own


@contextmanager
def recording(device) -> Iterator[wp.ScopedCapture]:
    """Kernels that are launched inside become a graph. No thread may wait for the device meanwhile."""
    DEVICE.wait_for_others()
    with wp.ScopedCapture(device=device) as recorded:
        yield recorded
