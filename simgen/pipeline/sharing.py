"""Sharing of tasks among workers: a worker gets the next one when it has room, so that all workers end together."""

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from typing import Any

LOOK_S = 0.25  # least time between two looks at the workers
AT_ONCE = 2  # tasks at a time for a worker that does not tell its room
NONE = object()


class Sharing:
    """Tasks that any worker can take. Each is handed to the worker that has most room.

    tasks : taken as they are handed out, but one is taken ahead
    workers : returns the addresses of all workers
    ask : asks workers at these addresses. It returns a pair by address: the number of shared tasks that have begun
        there, and the number of those for which there is room. It returns anything else, or nothing, for a worker that
        does not tell
    """

    def __init__(self, tasks: Iterable, workers: Callable[[], Iterable[str]], ask: Callable[[list[str]], dict]):
        self._tasks, self._workers, self._ask = iter(tasks), workers, ask
        self._next, self._looked = NONE, 0.0
        self._given, self._under_way = Counter(), Counter()  # tasks by address: all, and those without a result

    @property
    def left(self) -> bool:
        """True if there is a task that no worker has."""
        if self._next is NONE:
            self._next = next(self._tasks, NONE)
        return self._next is not NONE

    def hand_out(self, idle: bool) -> Iterator[tuple[Any, str | None]]:
        """Yield tasks with the addresses of the workers that should take them, until no worker has room.

        idle : True if no task of any kind is under way. Then at least one task is handed out. Its address is None if
            there is no worker
        """
        addresses = list(self._workers()) if self.left else []
        if addresses and (idle or time.monotonic() - self._looked >= LOOK_S):
            rooms = self._rooms(addresses)
            while (idle or max(rooms.values()) > 0) and self.left:
                address, idle = max(rooms, key=rooms.get), False
                rooms[address] -= 1
                self._given[address] += 1
                self._under_way[address] += 1
                yield self._take(), address
        elif idle and self.left:
            yield self._take(), None

    def end(self, address: str | None):
        """Note that a task of the worker at this address has a result."""
        self._under_way[address] -= 1

    def _take(self) -> Any:
        task, self._next = self._next, NONE
        return task

    def _rooms(self, addresses: list[str]) -> dict[str, int]:
        """Number of tasks by address for which a worker has room.

        Tasks on their way to a worker take room there, too. Some never begin there: they fail before, or another worker
        takes them.
        """
        found, rooms = self._ask(addresses), {}
        self._looked = time.monotonic()
        for address in addresses:
            if isinstance(told := found.get(address), tuple):
                begun, room = told
                rooms[address] = room - min(self._under_way[address], max(0, self._given[address] - begun))
            else:
                rooms[address] = AT_ONCE - self._under_way[address]
        return rooms
