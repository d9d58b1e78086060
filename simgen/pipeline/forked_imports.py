"""Imports of worker processes, done once: workers are forked from a process that has imported what they need."""

import ctypes
import multiprocessing
import multiprocessing.forkserver
import multiprocessing.resource_tracker
import multiprocessing.util
import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path

CAN_FORK = sys.platform == "linux"  # other systems have no safe fork
DRIVER, NOT_INITIALISED = "libcuda.so.1", 3  # CUDA's driver, and its error before `cuInit`
IMPORTED = ["simgen.pipeline.worker_imports"]
# What dask sets before it starts a worker; libraries read it as they are imported. Each worker uses one core.
ENVIRONMENT = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def start_imports(as_copy: bool = False) -> None:
    """Start the process that workers are forked from, unless it runs already. It imports while the caller goes on.

    That process has no threads, and initialises neither Warp nor CUDA. Without it, each worker takes 2 to 3 s for
    its imports.

    as_copy : if possible, that process begins as a copy of this one, which has most of the imports. Libraries of linear
        algebra use as many threads there as here, whatever `ENVIRONMENT` says
    """
    if not CAN_FORK:
        return
    multiprocessing.set_forkserver_preload(IMPORTED)
    multiprocessing.resource_tracker.ensure_running()  # otherwise it starts inside, and lets interrupts in
    with _no_interrupts(), _environment(), _copies() if as_copy and can_be_copied() else nullcontext():
        multiprocessing.forkserver.ensure_running()


def can_be_copied() -> bool:
    """True if a copy of this process would work: it has one thread of Python, and has not initialised CUDA.

    Threads that a library runs outside Python are not seen. Those of linear algebra prepare for a copy themselves.
    """
    return len(sys._current_frames()) == 1 and not cuda_is_initialised()


def cuda_is_initialised() -> bool:
    """True if a library has called `cuInit` in this process. CUDA does not work in a copy that is made later."""
    if "libcuda.so" not in Path("/proc/self/maps").read_text():
        return False
    return ctypes.CDLL(DRIVER).cuDeviceGetCount(ctypes.byref(ctypes.c_int())) != NOT_INITIALISED


@contextmanager
def _copies() -> Iterator[None]:
    """Let `multiprocessing` copy this process where it would start Python anew."""
    start_anew = multiprocessing.util.spawnv_passfds

    def copy(path: bytes, arguments: list[str], descriptors: list[int]) -> int:
        for stream in (sys.stdout, sys.stderr):
            with suppress(Exception):
                stream.flush()  # otherwise each worker writes what the buffer holds once more
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about the threads of libraries
            process = os.fork()
        if process:
            return process
        code = 0
        try:
            multiprocessing.util.spawnv_passfds = start_anew
            _forget_the_caller(descriptors)
            exec(arguments[-1])  # the program of the process that workers are forked from
        except SystemExit:
            pass
        except BaseException:
            sys.excepthook(*sys.exc_info())
            code = 1
        finally:
            os._exit(code)

    multiprocessing.util.spawnv_passfds = copy
    try:
        yield
    finally:
        multiprocessing.util.spawnv_passfds = start_anew


def _forget_the_caller(descriptors: list[int]) -> None:
    """Give up what a copy has of the caller: its signal handlers, and all files but the standard ones and these.

    A file gives way to the null device, so that no other file gets its number while objects of the caller have it.
    """
    signal.set_wakeup_fd(-1)
    for number in signal.valid_signals() - {signal.SIGINT}:  # the server sets this one
        if callable(signal.getsignal(number)):
            signal.signal(number, signal.SIG_DFL)
    null = os.open(os.devnull, os.O_RDWR)
    for each in {int(name) for name in os.listdir("/proc/self/fd")} - {0, 1, 2, null, *descriptors}:
        os.dup2(null, each, inheritable=False)
    tracker = multiprocessing.resource_tracker._resource_tracker
    tracker._fd = tracker._pid = None
    multiprocessing.forkserver._forkserver._lock = threading.Lock()  # the caller holds it while it makes the copy


@contextmanager
def _no_interrupts() -> Iterator[None]:
    """Block interrupts in processes that start inside: a terminal sends them to all, and only the caller answers."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _environment() -> Iterator[None]:
    """Set the variables of `ENVIRONMENT` that the user has not set."""
    added = {name: value for name, value in ENVIRONMENT.items() if name not in os.environ}
    os.environ.update(added)
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]
