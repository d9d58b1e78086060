"""Queue of presses that wait for a free environment; presses of hard indenters go first."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Collection, Iterator
from itertools import count
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from simgen.simulation.tries import Press


HARD = 2.0  # an indenter is hard if one of its tries took more than this times the mean of all tries
SLOW = 1.5  # an indenter is slow if its tries take more than this times the mean of all; on the DIGIT only the cube is


class PressQueue:
    """Presses in the order in which they should begin.

    A run ends when its last press ends, and a few presses take ten times the Newton iterations of most. So presses of
    hard indenters begin first, in the order of their longest tries. All other presses keep their order, so that tasks
    end one after the other. The queue learns the lengths of tries from tries that have ended. An indenter without an
    ended try counts as the hardest. A second try goes before all others.

    beside : another queue. The two share all presses that begin their first try: the other one takes the hardest, and
        this one the easiest. While the other one's environments have presses of slow indenters, it takes only slow and
        hard ones: few presses have short iterations, and the slowest of them decide when a run ends
    slow : shapes that count as slow until one of their tries has ended
    """

    def __init__(self, beside: PressQueue | None = None, slow: Collection[int] = ()):
        self._shared = _Shared(slow) if beside is None else beside._shared
        self._shared.queues += 1
        self._takes_hardest = beside is None
        self._again: deque[Press] = deque()

    def add(self, press: Press):
        if press.tries:
            self._again.append(press)
        else:
            shared = self._shared
            shared.by_shape.setdefault(press.shape, deque()).append((next(shared.numbers), press))

    def pop(self, running: Collection[int] = ()) -> Press | None:
        """Take the press that should begin now, beside running ones of these shapes; None if none should."""
        if self._again:
            return self._again.popleft()
        shared, first = self._shared, self._takes_hardest
        only_slow = first and shared.queues > 1 and any(map(shared.is_slow, running))
        order = {}
        for shape, waiting in shared.by_shape.items():
            hardness, slow = shared.hardness(shape), shared.is_slow(shape)
            if waiting and (not only_slow or slow or 0.0 < hardness < math.inf):
                unlike = hardness == math.inf and slow is not first  # of the indenters without an ended try
                order[shape] = (-hardness if first else hardness, unlike, waiting[0][0])
        return shared.by_shape[min(order, key=order.get)].popleft()[1] if order else None

    def learn(self, shape: int, iterations: int):
        """Note that a try with this shape has ended after this number of Newton iterations."""
        shared = self._shared
        shared.longest[shape] = max(iterations, shared.longest.get(shape, 0))
        shared.iterations[shape] += iterations
        shared.tries[shape] += 1

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

    queues : number of queues that share this
    by_shape : shape -> (number of arrival, press)
    longest : shape -> Newton iterations of its longest try that has ended
    iterations, tries : shape -> sum of Newton iterations of ended tries, and their number
    """

    def __init__(self, slow: Collection[int]):
        self.queues, self._slow = 0, set(slow)
        self.by_shape: dict[int, deque[tuple[int, Press]]] = {}
        self.numbers = count()
        self.longest: dict[int, int] = {}
        self.iterations, self.tries = Counter(), Counter()

    def hardness(self, shape: int) -> float:
        """Newton iterations of a hard indenter's longest try; 0 if the indenter is not hard."""
        if shape not in self.longest:
            return math.inf
        longest = self.longest[shape]
        return longest if self._is_above(longest, 1, HARD) else 0

    def is_slow(self, shape: int) -> bool:
        """True if the tries of an indenter take much longer than those of all indenters, or probably will."""
        if not self.tries[shape]:
            return shape in self._slow
        return self._is_above(self.iterations[shape], self.tries[shape], SLOW)

    def _is_above(self, iterations: int, tries: int, factor: float) -> bool:
        """True if so many iterations are more than a factor times the mean of as many tries."""
        return iterations * self.tries.total() > factor * tries * self.iterations.total()
