"""Pools: tasks of one process share the load stepping of each sensor, so that no environment is idle.

Some presses take ten times as many iterations as most. On a GPU hundreds of presses run at once, each in an environment
of its own. If each task had its own load stepping, most environments would be idle while the last presses of the task
run. A few threads advance the pools for all tasks, each until its own presses have ended. The other threads sleep.
"""

from __future__ import annotations

import threading
import weakref
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import count, islice

import numpy as np
import warp as wp

from simgen.fem.device import DEVICE, stream_in_place
from simgen.geometry.signed_distance import Kind, RigidShape
from simgen.simulation.load_stepping import LoadStepping
from simgen.simulation.press import PressResult, Scene, begin_presses, result_of
from simgen.simulation.press_queue import PressQueue
from simgen.simulation.tries import Press
from simgen.units import MM_PER_M

POOLS: weakref.WeakSet[Pool] = weakref.WeakSet()  # of this process
FREED = threading.Condition()  # guards `Pool.taken`; notified when a thread gives a pool back
NUMBERS = count()
MANY = 64  # tries; pools with as many take turns on the device
# Kinds of indenters that press with a face, whose whole edge touches at once. On the DIGIT, cubes and rings take 2.1
# and 1.4 times the mean number of Newton iterations, and the last presses of a run are theirs.
PROBABLY_SLOW = {Kind.CUBE, Kind.RING}


class Pool:
    """Presses of some shapes along one path (d, 3) m with turns (d,) rad in a scene; see `press.follow`.

    beside : the first pool of the sensor, with an equal scene, for a second one. The two share the presses that wait,
        see `PressQueue`
    taken : True while a thread advances the presses
    condemned : True if that thread must drop the presses when it gives the pool back
    rank : sort key; pools with more unknowns go first, because their presses take longer, then those made first
    """

    def __init__(
        self,
        scene: Scene,
        shapes: Sequence[RigidShape],
        path_m: np.ndarray,
        turns_rad: np.ndarray,
        max_force_n: float,
        beside: Pool | None = None,
    ):
        scene.reset(list(shapes))
        path = np.column_stack([path_m * MM_PER_M, turns_rad])
        slow = [i for i, shape in enumerate(shapes) if Kind(shape.kind) in PROBABLY_SLOW]
        queue = PressQueue(beside and beside._stepping.queue, slow, scene.batch)
        self._shapes, self._stepping = shapes, LoadStepping(scene, path, max_force_n, queue)
        self._second: weakref.ref[Pool] | None = None
        if beside is not None:
            beside._second = weakref.ref(self)
        self._device = wp.get_device(scene.device)
        self.taken = self.condemned = False
        self._advances = self._seen = 0  # iterations of this pool, and of the second one when last looked at
        self.rank = -scene.unknowns, next(NUMBERS)
        self._arrived: deque[Arrival] = deque()
        wp.synchronize()  # the kernels that set up the scene ran on another stream
        with FREED:
            POOLS.add(self)

    def press(self, shape_of: Sequence[int], poses: np.ndarray, steps: np.ndarray) -> PendingResults:
        """Add presses: shape numbers (b,), poses (b, 4, 4) m, numbers of steps (b,). Returns their results to come."""
        results = PendingResults(self)
        if not len(shape_of):
            results.presses = []
            return results
        with FREED:
            self._arrived.append(Arrival(results, list(shape_of), np.asarray(poses), np.asarray(steps)))
            FREED.notify()
        return results

    @property
    def environments(self) -> int:
        """Number of presses that can run at a time."""
        return self._stepping.scene.batch

    @property
    def arrived(self) -> int:
        """Number of presses that a task has added, and that are not in the queue yet."""
        return sum(len(each.shape_of) for each in list(self._arrived))

    @property
    def waiting(self) -> int:
        """Number of presses that wait for an environment, of this pool or of one that shares them."""
        return len(self._stepping.queue)

    @property
    def remaining(self) -> int:
        """Number of presses that have arrived or wait, and of environments in use."""
        return self._stepping.remaining + self.arrived

    @property
    def device_rank(self) -> int:
        """Rank of this pool's thread among those that wait for the device.

        A pool with few tries, one of them slow, has their number as its rank. Iterations of few tries are short. Slow
        presses decide when a run ends. All other pools have the same rank, and take turns.
        """
        running = int(self._stepping.running.sum())
        return running if 0 < running < MANY and self._stepping.has_slow_press else MANY

    def advance(self):
        """Advance the presses by one iteration. The calling thread has taken the pool and holds the device."""
        self._use_stream()
        self._begin_arrived()
        self._stepping.queue.has_help = self._second_is_in_use()
        self._stepping.advance()
        self._advances += 1

    def _second_is_in_use(self) -> bool:
        """True if a thread has the second pool, or has advanced it since the last call.

        Between two iterations of the second pool, no thread has it.
        """
        second = self._second and self._second()
        if second is None:
            return False
        seen, self._seen = self._seen, second._advances
        return second.taken or self._seen != seen

    def _begin_arrived(self):
        """Begin arrived presses of whole tasks, until there are as many as environments.

        Hundreds of tasks may arrive together. First touches of one task at a time would take ten times as long.
        """
        batch, tasks = self._stepping.scene.batch, []
        for arrival in list(self._arrived):
            tasks.append(arrival)
            if sum(len(each.shape_of) for each in tasks) >= batch:
                break
        if not tasks:
            return
        shape_of = [shape for task in tasks for shape in task.shape_of]
        poses, steps = (np.concatenate([getattr(task, name) for task in tasks]) for name in ("poses", "steps"))
        presses = iter(begin_presses(self._stepping, self._shapes, shape_of, poses, steps))
        for task in tasks:
            task.results.presses = list(islice(presses, len(task.shape_of)))
            self._arrived.popleft()

    def _use_stream(self):
        if self._stream is not None:
            wp.set_stream(self._stream, self._device)

    @cached_property
    def _stream(self) -> wp.Stream | None:
        """A stream for the kernels of this pool."""
        return stream_in_place(self._device, self._place) if self._device.is_cuda else None

    @property
    def _place(self) -> int:
        """Place of this pool's kernels on the device: the number of pools that go first. At first use it is fixed.

        Of two pools of a sensor the first one goes first, because it has the slow presses. Idle pools of other jobs do
        not count.
        """
        with FREED:
            return sum(pool.rank < self.rank and bool(pool.remaining or not pool._advances) for pool in POOLS)

    def drop(self):
        """Drop all unfinished presses."""
        while self._arrived:
            self._arrived.popleft().results.dropped = True
        self._stepping.drop(self._stepping.unfinished)


@dataclass(frozen=True)
class Arrival:
    """Presses of a task that have not begun: shape numbers (b,), poses (b, 4, 4) m, numbers of steps (b,)."""

    results: PendingResults
    shape_of: list[int]
    poses: np.ndarray
    steps: np.ndarray


class PendingResults:
    """Results of presses, in order. Iteration over the results waits until all presses have ended.

    presses : None until the presses begin
    dropped : True if they will not begin
    pools : those in which the presses may begin; they live until the presses end
    """

    def __init__(self, pool: Pool):
        self.pools, self._stepping = [pool], pool._stepping
        self.presses: list[Press] | None = None
        self.dropped = False

    def __iter__(self) -> Iterator[PressResult]:
        while self.unfinished and CREW.join(self):
            try:
                while self.unfinished:
                    _advance(self)
            finally:
                CREW.leave()
        if self.dropped or any(press.dropped for press in self.presses):
            raise RuntimeError("another task of this process has failed, and its presses ran together with these")
        return (result_of(self._stepping, press) for press in self.presses)

    @property
    def unfinished(self) -> bool:
        """True while some presses have neither ended nor been dropped."""
        if self.presses is None:
            return not self.dropped
        return any(press.status is None and not press.dropped for press in self.presses)


class Crew:
    """Threads that advance all pools. Other threads sleep until their presses have ended or they join the crew."""

    def __init__(self, most: int):
        self._lock, self._free = threading.Lock(), most
        self._asleep: dict[PendingResults, tuple[threading.Event, list[bool]]] = {}

    def join(self, results: PendingResults) -> bool:
        """Join the crew and return True, or sleep until these results are ready and return False."""
        with self._lock:
            if self._free:
                self._free -= 1
                return True
            woken, joins = self._asleep[results] = threading.Event(), [False]
        woken.wait()
        return joins[0]

    def leave(self):
        """Leave the crew, and wake a thread with running presses to join it."""
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
        for results in [each for each in self._asleep if not each.unfinished]:
            self._asleep.pop(results)[0].set()


# On a GPU, pools run beside each other: kernels of one run while other threads prepare those of the next. Two of four
# pools often have only their last few presses, which take long and leave the device idle.
THREADS = 4
CREW = Crew(THREADS)


def _advance(results: PendingResults):
    """Advance a free pool by one iteration; wait for one, but not longer than until the results are ready.

    An error drops all presses of the process, whose states are unknown then.
    """
    pool = _take(results)
    if pool is None:
        return
    try:
        with DEVICE.with_rank(pool.device_rank):
            pool.advance()
    except BaseException:
        with FREED:
            pools = list(POOLS)
            for each in pools:
                each.condemned = True
            for each in pools:
                if not each.taken:
                    _give_back(each)
        raise
    finally:
        with FREED:
            failed = pool.condemned
            _give_back(pool)
            if failed:
                FREED.wait_for(lambda: not any(each.condemned for each in list(POOLS)))
        CREW.wake_those_done()


def _take(results: PendingResults) -> Pool | None:
    """Take the first pool with presses that no other thread advances; None once the results are ready.

    So the last presses of one pool run beside many presses of the next.
    """
    with FREED:
        while results.unfinished:
            pools = _in_order()
            if not any(pool.condemned for pool in pools):  # what it drops may be in another pool's queue, too
                for pool in pools:
                    if not pool.taken and pool.remaining:
                        pool.taken = True
                        return pool
            FREED.wait()
    return None


def _give_back(pool: Pool):
    """Let others take the pool. The calling thread holds `FREED`."""
    try:
        if pool.condemned:
            pool.drop()
    finally:
        pool.taken = pool.condemned = False
        FREED.notify_all()


def _in_order() -> list[Pool]:
    return sorted(POOLS, key=lambda pool: pool.rank)
