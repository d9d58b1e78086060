"""Queue of presses that wait for a free environment; presses of hard indenters go first."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from itertools import count
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from simgen.simulation.tries import Press


HARD = 2.0  # an indenter is hard if one of its tries took more than this times the mean of all tries


class PressQueue:
    """Presses in the order in which they should begin.

    A run ends when its last press ends, and a few presses take ten times the Newton iterations of most. So presses of
    hard indenters begin first, in the order of their longest tries. All other presses keep their order, so that tasks
    end one after the other. The queue learns the lengths of tries from tries that have ended. An indenter without an
    ended try counts as the hardest. A second try goes before all others.
    """

    def __init__(self):
        self._by_shape: dict[int, deque[tuple[int, Press]]] = {}
        self._again: deque[Press] = deque()
        self._numbers = count()
        self._longest: dict[int, int] = {}  # Newton iterations of a try with this shape
        self._iterations = self._tries = 0  # of all shapes

    def add(self, press: Press):
        if press.tries:
            self._again.append(press)
        else:
            self._by_shape.setdefault(press.shape, deque()).append((next(self._numbers), press))

    def pop(self) -> Press:
        """Take the press that should begin now. Raises IndexError if none waits."""
        if self._again:
            return self._again.popleft()
        waiting = {shape: presses for shape, presses in self._by_shape.items() if presses}
        if not waiting:
            raise IndexError("no press waits")
        first = max(waiting, key=lambda shape: (self._hardness(shape), -waiting[shape][0][0]))
        return waiting[first].popleft()[1]

    def learn(self, shape: int, iterations: int):
        """Note that a try with this shape has ended after this number of Newton iterations."""
        self._longest[shape] = max(iterations, self._longest.get(shape, 0))
        self._iterations += iterations
        self._tries += 1

    def _hardness(self, shape: int) -> float:
        """Newton iterations of a hard indenter's longest try; 0 if the indenter is not hard."""
        if shape not in self._longest:
            return math.inf
        longest = self._longest[shape]
        return longest if longest * self._tries > HARD * self._iterations else 0

    def remove_dropped(self):
        self._again = deque(press for press in self._again if not press.dropped)
        for shape, presses in self._by_shape.items():
            self._by_shape[shape] = deque(each for each in presses if not each[1].dropped)

    def __len__(self) -> int:
        return len(self._again) + sum(map(len, self._by_shape.values()))

    def __iter__(self) -> Iterator[Press]:
        yield from self._again
        for presses in self._by_shape.values():
            yield from (press for _, press in presses)
