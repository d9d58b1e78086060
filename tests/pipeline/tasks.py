"""Tasks for workers."""

import os
import threading
import time

ONE_AT_A_TIME = threading.Lock()


LEAST_SHARED_S = 0.1  # shorter tasks are not shared
BEGUN, ENDED = [], []  # tasks of this process


def uneven_task(seconds: float) -> tuple[str, float, float]:
    """Wait, fifteen times as long if this process sees GPU 1. Returns the GPU, and when the wait began and ended."""
    gpu, begin = os.environ["CUDA_VISIBLE_DEVICES"], time.time()
    BEGUN.append(seconds)
    time.sleep(15.0 * seconds if gpu == "1" else seconds)
    ENDED.append(seconds)
    return gpu, begin, time.time()


def room_for_three() -> tuple[int, int]:
    """Room for three shared tasks at a time."""
    begun, ended = (sum(seconds >= LEAST_SHARED_S for seconds in list(tasks)) for tasks in (BEGUN, ENDED))
    return begun, 3 - (begun - ended)


def no_room() -> tuple[int, int]:
    return 0, -1


def unknown_room() -> None:
    return None


def process_after(seconds: float) -> int:
    """The process that this ran in; one at a time in each, as presses are."""
    with ONE_AT_A_TIME:
        time.sleep(seconds)
    return os.getpid()


def reciprocal(number: int) -> float:
    return 1.0 / number


def fail_with(error: Exception | None):
    if error is not None:
        raise error


def no_preparation(*arguments):
    """In place of `simgen.pipeline.shard.prepare`, which needs the device."""
