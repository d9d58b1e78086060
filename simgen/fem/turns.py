"""Turns of threads on the device: a lock that serves threads by rank."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from heapq import heappop, heappush
from itertools import count

LAST = 1_000_000  # rank of threads that have not set their own


class Queue:
    """Lock that serves waiting threads by rank, and threads of the same rank in the order of their arrival.

    Lower ranks go first. A thread without a rank of its own has `LAST`: it may wait as long as others come.
    """

    def __init__(self):
        self._lock, self._taken = threading.Lock(), False
        self._turns: list[tuple[int, int, threading.Lock]] = []  # heap of (rank, arrival, lock until the turn)
        self._arrivals, self._own = count(), threading.local()
        self._owner, self._waits = None, 0

    @property
    def _rank(self) -> int:
        """Rank of the calling thread."""
        return getattr(self._own, "rank", LAST)

    @contextmanager
    def with_rank(self, rank: int) -> Iterator[None]:
        """Hold the lock, and have a rank each time that this thread waits for it inside."""
        before, self._own.rank = self._rank, rank
        try:
            with self:
                yield
        finally:
            self._own.rank = before

    def __enter__(self):
        self._own.arrival = next(self._arrivals)
        self._await_turn()

    def _await_turn(self):
        turn = None
        with self._lock:
            if self._taken:
                turn = threading.Lock()
                turn.acquire()
                heappush(self._turns, (self._rank, self._own.arrival, turn))
            self._taken = True
        if turn is not None:
            turn.acquire()  # until the thread before releases the lock
        self._owner = threading.get_ident()

    def __exit__(self, *error):
        self._owner = None
        with self._lock:
            if self._turns:
                heappop(self._turns)[2].release()
            else:
                self._taken = False

    @property
    def mine(self) -> bool:
        """True for the thread that holds the lock."""
        return self._owner == threading.get_ident()

    @property
    def delays_others(self) -> bool:
        """True if a thread of lower rank than the calling one waits."""
        return self.mine and bool(self._turns) and self._turns[0][0] < self._rank  # only the owner takes turns away

    def step_aside(self):
        """Let threads of lower rank in, and come back before all others of the own rank."""
        self.__exit__()
        self._await_turn()

    @contextmanager
    def left(self) -> Iterator[None]:
        """Release the lock while this thread waits for the device."""
        with self._lock:
            self._waits += 1
        self.__exit__()
        try:
            yield
        finally:
            with self._lock:
                self._waits -= 1
            self.__enter__()

    def wait_for_others(self):
        """Wait until no other thread waits for the device: this one may then act on the whole device."""
        while self._waits:
            time.sleep(1e-4)
