"""Tasks for workers."""

import os
import threading
import time

ONE_AT_A_TIME = threading.Lock()


def uneven_task(seconds: float) -> tuple[str, float, float]:
    """Wait, fifteen times as long if this process sees GPU 1. Returns the GPU, and when the wait began and ended."""
    gpu, begin = os.environ["CUDA_VISIBLE_DEVICES"], time.time()
    time.sleep(15.0 * seconds if gpu == "1" else seconds)
    return gpu, begin, time.time()


def process_after(seconds: float) -> int:
    """The process that this ran in; one at a time in each, as presses are."""
    with ONE_AT_A_TIME:
        time.sleep(seconds)
    return os.getpid()


def reciprocal(number: int) -> float:
    return 1.0 / number
