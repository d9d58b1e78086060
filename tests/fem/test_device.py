"""Threads that take turns on the device, and arrays that they read from it."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import warp as wp

from simgen.fem.device import DEVICE, Queue, read


def test_a_queue_lets_threads_in_by_turns():
    """A plain lock may let the thread that leaves it in again, however long others wait."""
    queue, order = Queue(), []

    def work(name):
        with queue:
            order.append(name)

    with ThreadPoolExecutor(2) as threads:
        with queue:
            for count, name in enumerate("ab"):
                threads.submit(work, name)
                while len(queue._turns) < 2 + count:
                    time.sleep(0.001)
        work("c")
    assert order == ["a", "b", "c"]


def test_a_thread_that_waits_for_the_device_lets_another_in_and_comes_back_after_it():
    queue, order, left = Queue(), [], threading.Event()

    def other():
        left.wait()
        with queue:
            order.append("other")

    with ThreadPoolExecutor(1) as threads, queue:
        order.append("first")
        task = threads.submit(other)
        with queue.left():
            assert not queue.mine
            left.set()
            task.result(timeout=10.0)
        assert queue.mine
        order.append("back")
    assert order == ["first", "other", "back"] and not queue.mine


def test_what_concerns_the_whole_device_waits_until_no_thread_waits_for_it():
    queue, waits, done = Queue(), threading.Event(), threading.Event()

    def slow():
        with queue, queue.left():
            waits.set()
            done.wait()

    with ThreadPoolExecutor(1) as threads:
        task = threads.submit(slow)
        waits.wait()
        with queue:
            threading.Timer(0.05, done.set).start()
            queue.wait_for_others()
            assert done.is_set()
        task.result(timeout=10.0)


def test_arrays_are_read_together_with_and_without_the_device():
    a, b = (wp.array(np.arange(n, dtype=float), dtype=wp.float64, device="cpu") for n in (2, 3))
    with DEVICE:
        inside = read(a, b)
    for found in (inside, read(a, b)):
        np.testing.assert_array_equal(found[0], [0.0, 1.0])
        np.testing.assert_array_equal(found[1], [0.0, 1.0, 2.0])
