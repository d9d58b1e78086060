"""Imports of worker processes, done once: workers are forked from a process that has imported what they need."""

import multiprocessing
import multiprocessing.forkserver
import multiprocessing.resource_tracker
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager

CAN_FORK = sys.platform == "linux"  # other systems have no safe fork
IMPORTED = ["simgen.pipeline.worker_imports"]
# What dask sets before it starts a worker; libraries read it as they are imported. Each worker uses one core.
ENVIRONMENT = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def start_imports() -> None:
    """Start the process that workers are forked from, unless it runs already. It imports while the caller goes on.

    That process has no threads, and initialises neither Warp nor CUDA. Without it, each worker takes 2 to 3 s for
    its imports.
    """
    if not CAN_FORK:
        return
    multiprocessing.set_forkserver_preload(IMPORTED)
    multiprocessing.resource_tracker.ensure_running()  # otherwise it starts inside, and lets interrupts in
    with _no_interrupts(), _environment():
        multiprocessing.forkserver.ensure_running()


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
