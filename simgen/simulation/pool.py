"""Presses of several tasks side by side on one device: what the hard ones of one task leave free serves the next.

Some presses take ten times as many iterations as most. On a GPU hundreds are under way at once, and a task that waited
alone for its last presses would leave the device idle most of the time. So the tasks of a process share the load
stepping of each sensor. One or two tasks carry it on for all, each until its own presses have ended. The others sleep.
"""

from __future__ import annotations

import threading
import weakref
from collections.abc import Iterator, Sequence

import numpy as np
import warp as wp

from simgen.fem.device import DEVICE
from simgen.geometry.signed_distance import RigidShape
from simgen.simulation.load_stepping import LoadStepping
from simgen.simulation.press import PressResult, Scene, begin_presses, result_of
from simgen.simulation.tries import Press
from simgen.units import MM_PER_M

POOLS: weakref.WeakSet[Pool] = weakref.WeakSet()  # of this process


class Pool:
    """Presses of some shapes along one path (d, 3) m with turns (d,) rad in a scene; see `press.follow`.

    turn : for the one thread that carries the presses on
    """

    def __init__(
        self, scene: Scene, shapes: Sequence[RigidShape], path_m: np.ndarray, turns_rad: np.ndarray, max_force_n: float
    ):
        scene.reset(list(shapes))
        path = np.column_stack([path_m * MM_PER_M, turns_rad])
        self._shapes, self._stepping = shapes, LoadStepping(scene, path, max_force_n)
        self._device, self.turn = wp.get_device(scene.device), threading.Lock()
        self._stream = wp.Stream(self._device) if self._device.is_cuda else None
        wp.synchronize()  # what the scene has been made with ran on another stream
        POOLS.add(self)

    def press(self, shape_of: Sequence[int], poses: np.ndarray, steps: np.ndarray) -> Pressing:
        """Put presses under way: shape numbers (b,), poses (b, 4, 4) m, most steps (b,). Returns their results."""
        with DEVICE:
            self._use_stream()
            return Pressing(self._stepping, begin_presses(self._stepping, self._shapes, shape_of, poses, steps))

    @property
    def urgency(self) -> tuple[int, int]:
        """The pool that keeps most environments at work goes on first, then the one that has most presses left."""
        return self._stepping.busy, self._stepping.left

    def go_on(self):
        """Carry the presses on by an iteration. The thread has the pool's `turn`, and the device."""
        self._use_stream()
        self._stepping.go_on()

    def _use_stream(self):
        if self._stream is not None:
            wp.set_stream(self._stream, self._device)

    def drop(self):
        """Forget all presses that have not ended."""
        self._stepping.drop(self._stepping.unfinished)


class Pressing:
    """Results of presses that are under way, in their order. To iterate over them waits until all have ended."""

    def __init__(self, stepping: LoadStepping, presses: list[Press]):
        self._stepping, self._presses = stepping, presses

    def __iter__(self) -> Iterator[PressResult]:
        while self.under_way and CREW.join(self):
            try:
                while self.under_way:
                    _go_on()
            finally:
                CREW.leave()
        if any(press.dropped for press in self._presses):
            raise RuntimeError("another task of this process has failed, and its presses were solved with these")
        return (result_of(self._stepping, press) for press in self._presses)

    @property
    def under_way(self) -> bool:
        """True while some of the presses have not ended and nobody has dropped them."""
        return any(press.status is None and not press.dropped for press in self._presses)


class Crew:
    """The threads that carry all pools on; other threads sleep until what they wait for has ended, or join."""

    def __init__(self, most: int):
        self._lock, self._free = threading.Lock(), most
        self._asleep: dict[Pressing, tuple[threading.Event, list[bool]]] = {}

    def join(self, pressing: Pressing) -> bool:
        """Return True if this thread joins the crew, False if it slept until its presses had ended."""
        with self._lock:
            if self._free:
                self._free -= 1
                return True
            woken, joins = self._asleep[pressing] = threading.Event(), [False]
        woken.wait()
        return joins[0]

    def leave(self):
        """Leave the crew, and let a thread join whose presses are under way."""
        with self._lock:
            self._wake_those_done()
            if not self._asleep:
                self._free += 1
                return
            woken, joins = self._asleep.pop(next(iter(self._asleep)))
            joins[0] = True
            woken.set()

    def wake_those_done(self):
        with self._lock:
            self._wake_those_done()

    def _wake_those_done(self):
        for pressing in [each for each in self._asleep if not each.under_way]:
            self._asleep.pop(pressing)[0].set()


BESIDE = 0.5  # of the environments of the busiest pool: what another one must have at work to go on beside it
# On a GPU two pools go on at once: the kernels of one run while another thread prepares those of the other.
CREW = Crew(2)


def _go_on():
    """Carry a pool on by an iteration. An error ends all presses of the process: none is in order then."""
    try:
        with DEVICE:
            pool = _choose()
            if mine := pool.turn.acquire(blocking=False):
                try:
                    pool.go_on()
                finally:
                    pool.turn.release()
        if not mine:
            with pool.turn:
                pass  # another thread of the crew has carried it on
    except BaseException:
        for each in list(POOLS):
            with each.turn, DEVICE:
                each.drop()
        raise
    finally:
        CREW.wake_those_done()


def _choose() -> Pool:
    """The most urgent pool, or where it is under way another one that is about as busy, if there is one."""
    pools = sorted(POOLS, key=lambda pool: pool.urgency, reverse=True)
    least = BESIDE * pools[0].urgency[0]
    return next((each for each in pools if each.urgency[0] >= least and not each.turn.locked()), pools[0])
