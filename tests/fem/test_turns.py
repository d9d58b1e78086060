"""Threads that take turns on the device: by rank, and in the order of their arrival."""

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from simgen.fem.turns import Queue


def wait_until(reached: Callable[[], bool]):
    deadline = time.monotonic() + 20.0
    while not reached():
        assert time.monotonic() < deadline
        time.sleep(0.001)


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
                wait_until(lambda count=count: len(queue._turns) == 1 + count)
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


def test_threads_of_lower_rank_go_first():
    queue, order = Queue(), []

    def work(rank):
        with queue.with_rank(rank):
            order.append(rank)

    with ThreadPoolExecutor(4) as threads, queue:
        for count, rank in enumerate((64, 3, 64, 1)):
            threads.submit(work, rank)
            wait_until(lambda count=count: len(queue._turns) == 1 + count)
    assert order == [1, 3, 64, 64]


def test_a_thread_steps_aside_for_a_lower_rank_and_comes_back_before_its_equals():
    queue, order = Queue(), []

    def work(rank, name):
        with queue.with_rank(rank):
            order.append(name)

    with ThreadPoolExecutor(2) as threads, queue.with_rank(64):
        assert not queue.delays_others
        threads.submit(work, 64, "equal")
        wait_until(lambda: len(queue._turns) == 1)
        assert not queue.delays_others
        threads.submit(work, 2, "few")
        wait_until(lambda: len(queue._turns) == 2)
        assert queue.delays_others
        queue.step_aside()
        assert queue.mine and not queue.delays_others
        order.append("first")
    assert order == ["few", "first", "equal"]
