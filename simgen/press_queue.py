"""Presses that wait for a free environment, the hardest first."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from itertools import count
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .march import Press


class PressQueue:
    """Presses in the order in which they should begin.

    A run ends when its last press ends. The hardest presses take ten times the Newton iterations of most, so they
    begin early. The queue learns how hard an indenter is from presses that have ended. An indenter that it knows
    nothing of goes first. Presses of the same indenter keep their order. A press that is tried again goes before all.
    """

    def __init__(self):
        self._by_shape: dict[int, deque[tuple[int, Press]]] = {}
        self._again: deque[Press] = deque()
        self._numbers = count()
        self._mean: dict[int, tuple[float, int]] = {}  # Newton iterations of a try, and how many tries have ended

    def add(self, press: Press):
        if press.first_try is not None:
            self._again.append(press)
        else:
            self._by_shape.setdefault(press.shape, deque()).append((next(self._numbers), press))

    def pop(self) -> Press:
        """The press that should begin now. Raises IndexError if none waits."""
        if self._again:
            return self._again.popleft()
        waiting = {shape: presses for shape, presses in self._by_shape.items() if presses}
        if not waiting:
            raise IndexError("no press waits")
        hardest = max(waiting, key=lambda shape: (self._expected(shape), -waiting[shape][0][0]))
        return waiting[hardest].popleft()[1]

    def learn(self, shape: int, iterations: int):
        """A try with this indenter has ended after so many Newton iterations."""
        mean, tries = self._mean.get(shape, (0.0, 0))
        self._mean[shape] = (mean + (iterations - mean) / (tries + 1), tries + 1)

    def _expected(self, shape: int) -> float:
        return self._mean[shape][0] if shape in self._mean else math.inf

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
