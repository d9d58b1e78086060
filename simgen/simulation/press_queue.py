"""Queue of presses that wait for a free environment; presses of hard indenters go first."""

from __future__ import annotations

import math
import threading
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator, Sequence
from itertools import count

from simgen.simulation.tries import Press, more_tries, second_tries

HARD = 2.0  # an indenter is hard if one of its tries took more than this times the mean of all tries
SLOW = 1.5  # an indenter is slow if its tries take more than this times the mean of all


class PressQueue:
    """Presses in the order in which they should begin.

    A run ends when its last press ends, and a few presses take ten times the Newton iterations of most. So presses of
    hard indenters begin first, in the order of their longest tries. All other presses begin in such an order that they
    end in the order of their arrival: those with longer tries begin earlier. So tasks end one after the other, and the
    last presses of a run end together. The queue learns the lengths of tries from tries that have ended. An indenter
    without an ended try counts as the hardest. Second tries go before all others, third and fourth tries beside slow
    ones go last.

    A second queue can share the presses that begin their first try. The first queue then takes the hardest, and the
    second queue takes hard and slow ones last, and only if all environments of the first one are in use. While the
    second queue is in use and slow presses run, the first queue takes only slow and hard ones: with few presses, its
    iterations are short. It takes others, too, while as many presses wait as it has environments.

    beside : the first queue, for a second one
    slow : shapes that count as slow, whatever the mean of their tries is. Short tries end first, so the mean of a slow
        shape is low for long
    environments : number of presses that run at a time. With 0, the lengths of tries that are not hard do not count
    has_help : True while a thread starts presses from the second queue
    """

    def __init__(self, beside: PressQueue | None = None, slow: Collection[int] = (), environments: int = 0):
        self._shared = _Shared(slow) if beside is None else beside._shared
        self._shared.environments += environments
        self._is_first, self._environments = beside is None, environments
        self.has_help = False
        self._again: deque[Press] = deque()

    def add(self, press: Press):
        if press.tries:
            self._again.append(press)
        else:
            self._shared.add(press)

    def pop(self, beside_slow: bool = False) -> Press | None:
        """Take the press that should begin now; None if none should. beside_slow: True if a running press is slow."""
        if self._again:
            return self._again.popleft()
        shared = self._shared
        if not self._is_first:
            return shared.pop(shared.easiest_first, self._allowed)
        only_slow = self.has_help and beside_slow and not self._many_wait
        return shared.pop(shared.hardest_first, shared.is_slow_or_hard if only_slow else shared.is_any)

    def next_presses(self, slow: Sequence[Press], running: int, beside_slow: bool) -> Iterator[Press]:
        """Yield presses whose next try should begin now, in order. The caller begins each before it asks for the next.

        slow : presses whose running try has taken long enough for another try beside it, the slowest first
        running : number of running tries
        beside_slow : True if one of them is slow, see `is_slow`
        """
        for press in second_tries(slow, not len(self)):
            running += 1
            yield press
        while (press := self.pop(beside_slow)) is not None:
            beside_slow = beside_slow or self.is_slow(press.shape, 0)
            running += 1
            yield press
        yield from more_tries(slow, running)

    @property
    def _many_wait(self) -> bool:
        """True if the waiting presses would fill all environments of this queue."""
        return 0 < self._environments <= len(self)

    @property
    def _allowed(self) -> Callable[[int], bool]:
        """Test of shapes: True if presses with this shape may begin from this queue now."""
        leaves_slow = not self._is_first and self._shared.first_has_room
        return self._shared.is_easy if leaves_slow else self._shared.is_any

    def note_room(self, has_room: bool):
        """Note if this queue's presses leave an environment free. Only what the first queue notes counts."""
        if self._is_first:
            self._shared.first_has_room = has_room

    def learn(self, shape: int, iterations: int):
        """Note that a try with this shape has ended after this number of Newton iterations."""
        self._shared.learn(shape, int(iterations))

    def is_slow(self, shape: int, iterations: int) -> bool:
        """True if a running try is slow: its indenter is, or the try has taken long already."""
        return self._shared.is_slow(shape) or self._shared.is_long(int(iterations))

    def remove_dropped(self):
        self._again = deque(press for press in self._again if not press.dropped)
        self._shared.remove_dropped()

    def __len__(self) -> int:
        return len(self._again) + self._shared.count(self._allowed)

    def __iter__(self) -> Iterator[Press]:
        yield from self._again
        yield from self._shared.presses()


class _Shared:
    """First tries that wait, and what is known of the indenters' tries. Threads of two pools may use it.

    environments : of all queues
    first_has_room : True if the first queue's presses leave an environment free
    """

    def __init__(self, slow: Collection[int]):
        self._lock, self._slow, self.environments = threading.Lock(), set(slow), 0
        self.first_has_room = True
        self._by_shape: dict[int, deque[tuple[int, Press]]] = {}  # shape -> (number of arrival, press)
        self._arrivals = count()
        self._longest: dict[int, int] = {}  # shape -> Newton iterations of its longest try that has ended
        self._iterations, self._tries = Counter(), Counter()  # of ended tries, by shape
        self._all_iterations = self._all_tries = 0

    def count(self, allowed: Callable[[int], bool]) -> int:
        """Number of presses with allowed shapes."""
        with self._lock:
            return sum(len(waiting) for shape, waiting in self._by_shape.items() if allowed(shape))

    def add(self, press: Press):
        with self._lock:
            self._by_shape.setdefault(press.shape, deque()).append((next(self._arrivals), press))

    def pop(self, key: Callable[[int], tuple], allowed: Callable[[int], bool]) -> Press | None:
        """Take the oldest press of the allowed shape with the least key.

        Of shapes with the same key, the shape goes first whose oldest press should end first.
        """
        with self._lock:
            keys = {shape: (*key(shape), waiting[0][0] - self._lead(shape))
                    for shape, waiting in self._by_shape.items()
                    if waiting and allowed(shape)}  # fmt: skip
            if not keys:
                return None
            shape = min(keys, key=keys.get)
            return self._by_shape[shape].popleft()[1]

    def presses(self) -> list[Press]:
        with self._lock:
            return [press for waiting in self._by_shape.values() for _, press in waiting]

    def remove_dropped(self):
        with self._lock:
            for shape, waiting in self._by_shape.items():
                self._by_shape[shape] = deque(each for each in waiting if not each[1].dropped)

    def learn(self, shape: int, iterations: int):
        with self._lock:
            self._longest[shape] = max(iterations, self._longest.get(shape, 0))
            self._iterations[shape] += iterations
            self._tries[shape] += 1
            self._all_iterations += iterations
            self._all_tries += 1

    def hardest_first(self, shape: int) -> tuple:
        """Sort key. Shapes that are probably slow go before others that are as hard."""
        return -self._hardness(shape), shape not in self._slow

    def easiest_first(self, shape: int) -> tuple:
        return self.is_slow(shape), self._hardness(shape)

    def is_slow(self, shape: int) -> bool:
        """True if the tries of an indenter take much longer than those of all indenters, or probably will."""
        return shape in self._slow or self._is_above(self._iterations[shape], self._tries[shape], SLOW)

    def is_slow_or_hard(self, shape: int) -> bool:
        return self.is_slow(shape) or 0.0 < self._hardness(shape) < math.inf

    def is_easy(self, shape: int) -> bool:
        return not self.is_slow_or_hard(shape)

    def is_any(self, shape: int) -> bool:
        return True

    def _hardness(self, shape: int) -> float:
        """Newton iterations of a hard indenter's longest try; 0 if the indenter is not hard, inf if it is unknown."""
        if shape not in self._longest:
            return math.inf
        longest = self._longest[shape]
        return longest if self.is_long(longest) else 0.0

    def is_long(self, iterations: int) -> bool:
        """True if a try of so many Newton iterations is much longer than most."""
        return self._is_above(iterations, 1, HARD)

    def _lead(self, shape: int) -> float:
        """Number of presses that begin while one with this shape runs; 0 without an ended try."""
        if not self._tries[shape] or not self._all_iterations:
            return 0.0
        mean = self._all_iterations / self._all_tries
        return self.environments * self._iterations[shape] / self._tries[shape] / mean

    def _is_above(self, iterations: int, tries: int, factor: float) -> bool:
        """True if so many iterations are more than a factor times the mean of as many tries."""
        return iterations * self._all_tries > factor * tries * self._all_iterations
