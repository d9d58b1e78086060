"""Imports of worker processes, done once: workers are forked from a process that has imported what they need."""

import multiprocessing
import multiprocessing.forkserver
import sys

CAN_FORK = sys.platform == "linux"  # other systems have no safe fork
IMPORTED = ["distributed", "simgen.pipeline.shard"]


def start_imports() -> None:
    """Start the process that workers are forked from, unless it runs already. It imports while the caller goes on.

    It has no threads, and initialises neither Warp nor CUDA. Without it, each worker takes 3 s for its imports.
    """
    if CAN_FORK:
        multiprocessing.set_forkserver_preload(IMPORTED)
        multiprocessing.forkserver.ensure_running()
