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

    beside : another queue. The two share all presses that begin their first try: the other one takes the hardest, and
        this one the easiest
    """

    def __init__(self, beside: PressQueue | None = None):
        self._shared = _Shared() if beside is None else beside._shared
        self._takes_hardest = beside is None
        self._again: deque[Press] = deque()

    def add(self, press: Press):
        if press.tries:
            self._again.append(press)
        else:
            shared = self._shared
            shared.by_shape.setdefault(press.shape, deque()).append((next(shared.numbers), press))

    def pop(self) -> Press:
        """Take the press that should begin now. Raises IndexError if none waits."""
        if self._again:
            return self._again.popleft()
        shared, sign = self._shared, -1.0 if self._takes_hardest else 1.0
        order = {shape: (sign * shared.hardness(shape), waiting[0][0])
                 for shape, waiting in shared.by_shape.items() if waiting}  # fmt: skip
        if not order:
            raise IndexError("no press waits")
        return shared.by_shape[min(order, key=order.get)].popleft()[1]

    def learn(self, shape: int, iterations: int):
        """Note that a try with this shape has ended after this number of Newton iterations."""
        shared = self._shared
        shared.longest[shape] = max(iterations, shared.longest.get(shape, 0))
        shared.iterations += iterations
        shared.tries += 1

    def remove_dropped(self):
        self._again = deque(press for press in self._again if not press.dropped)
        for shape, waiting in list(self._shared.by_shape.items()):
            self._shared.by_shape[shape] = deque(each for each in list(waiting) if not each[1].dropped)

    def __len__(self) -> int:
        return len(self._again) + sum(map(len, self._shared.by_shape.values()))

    def __iter__(self) -> Iterator[Press]:
        yield from self._again
        for waiting in list(self._shared.by_shape.values()):  # a thread with the other queue may take some meanwhile
            yield from (press for _, press in list(waiting))


class _Shared:
    """First tries that wait, and what is known of the indenters' tries.

    by_shape : shape -> (number of arrival, press)
    longest : shape -> Newton iterations of its longest try that has ended
    iterations, tries : of all shapes
    """

    def __init__(self):
        self.by_shape: dict[int, deque[tuple[int, Press]]] = {}
        self.numbers = count()
        self.longest: dict[int, int] = {}
        self.iterations = self.tries = 0

    def hardness(self, shape: int) -> float:
        """Newton iterations of a hard indenter's longest try; 0 if the indenter is not hard."""
        if shape not in self.longest:
            return math.inf
        longest = self.longest[shape]
        return longest if longest * self.tries > HARD * self.iterations else 0
