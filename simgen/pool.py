"""Presses of several tasks side by side on one device: what the hard ones of one task leave free serves the next.

Some presses take ten times as many iterations as most. On a GPU hundreds are under way at once, and a task that waited
alone for its last presses would leave the device idle most of the time. So the tasks of a process share one march for
each sensor. Each task carries on the march that keeps the device busiest, until its own presses have ended.
"""

from __future__ import annotations

import threading
import weakref
from collections import deque
from collections.abc import Iterator, Sequence

import numpy as np

from simgen.distance import RigidShape
from simgen.march import March, Press
from simgen.press import MM, PressResult, Scene, begin_presses, result_of


class Queue:
    """A lock that lets threads in by turns, first come, first served; a plain one may keep to the same thread."""

    def __init__(self):
        self._lock, self._turns = threading.Lock(), deque()

    def __enter__(self):
        turn = threading.Lock()
        turn.acquire()
        with self._lock:
            first = not self._turns
            self._turns.append(turn)
        if not first:
            turn.acquire()  # until the one before lets go

    def __exit__(self, *error):
        with self._lock:
            self._turns.popleft()
            if self._turns:
                self._turns[0].release()


DEVICE = Queue()  # one thread of a process uses the device: it solves, or makes a scene
POOLS: weakref.WeakSet[Pool] = weakref.WeakSet()  # of this process


class Pool:
    """Presses of some shapes along one path (d, 3) m with turns (d,) rad in a scene; see `simgen.press.follow`."""

    def __init__(
        self, scene: Scene, shapes: Sequence[RigidShape], path_m: np.ndarray, turns_rad: np.ndarray, max_force_n: float
    ):
        scene.reset(list(shapes))
        self._shapes, self._march = shapes, March(scene, np.column_stack([path_m * MM, turns_rad]), max_force_n)
        POOLS.add(self)

    def press(self, shape_of: Sequence[int], poses: np.ndarray, steps: np.ndarray) -> Pressing:
        """Put presses under way: shape numbers (b,), poses (b, 4, 4) m, most steps (b,). Returns their results."""
        with DEVICE:
            return Pressing(self._march, begin_presses(self._march, self._shapes, shape_of, poses, steps))

    @property
    def urgency(self) -> tuple[int, int]:
        """The march that keeps most environments at work goes on first, then the one that has most before it."""
        return self._march.busy, self._march.left

    def go_on(self):
        self._march.go_on()

    def drop(self):
        """Forget all presses that have not ended."""
        self._march.drop(self._march.unfinished)


class Pressing:
    """Results of presses that are under way, in their order. To iterate over them waits until all have ended."""

    def __init__(self, march: March, presses: list[Press]):
        self._march, self._presses = march, presses

    def __iter__(self) -> Iterator[PressResult]:
        while self._under_way():
            with DEVICE:
                if self._under_way():
                    _go_on()
        return (result_of(self._march, press) for press in self._presses)

    def _under_way(self) -> bool:
        """Raises `RuntimeError` where an error in another task has ended them."""
        unfinished = [press for press in self._presses if press.status is None]
        if any(press.dropped for press in unfinished):
            raise RuntimeError("another task of this process has failed, and its presses were solved with these")
        return bool(unfinished)


def _go_on():
    """Carry on the most urgent pool by an iteration. An error ends all presses of the process: none is in order."""
    try:
        max(POOLS, key=lambda pool: pool.urgency).go_on()
    except BaseException:
        for pool in POOLS:
            pool.drop()
        raise
