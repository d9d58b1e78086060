"""A press and its tries: a press whose first try fails or is slow is solved again from rest."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from simgen.simulation.measurements import PressSample, PressSamples

# Longest load steps of a press's tries over those of the first. On a GPU a try with the steps of the first takes
# another path, because the order of sums depends on the threads. 2 of 128 such tries of hard cubes and rings on the
# DIGIT miss a depth. With 0.7 and 0.5 times these steps 12 and 7 do (two H200s,
# `docs/benchmarks/few_presses_h200.json`).
STEP_SCALES = (1.0, 0.5, 1.0, 0.7)
MOST_WITHOUT_A_RACE = 2  # tries of a press on a CPU
# Newton iterations since the last sample, after which the second try begins beside the first if an environment is free,
# and the same for the iterations of a whole try. A run ends when its last press ends. Computed from both tries of slow
# cubes and rings on the DIGIT, that would be after 1,031 to 1,383 iterations if the try that ends first counts. With
# 300 and 450 it would be after 1,181 to 1,483, and after 1,328 to 1,762 if the first try counts unless it fails (four
# runs on H200s, `docs/benchmarks/two_tries_h200.json`).
SECOND_TRY_ITERATIONS = 150
SECOND_TRY_AFTER = 350
# Third and fourth tries begin beside slow ones while fewer tries than these run in a pool and no press may begin there.
FEW_TRIES = 8


@dataclass(eq=False)
class Try:
    """One attempt to follow the path from rest.

    step_scale : factor on the longest load steps
    samples : converged steps, without large outputs
    large : outputs at vertices and pixels by name, arrays (d, ...) for all steps of the path; empty before the first
        sample
    status : how the try ended; None before
    failed : True where the solver failed, so that another try may get further
    """

    step_scale: float
    samples: list[PressSample] = field(default_factory=list)
    large: dict[str, np.ndarray] = field(default_factory=dict)
    status: int | None = None
    failed: bool = False

    @property
    def completed(self) -> bool:
        """True if the try has ended and has not failed."""
        return self.status is not None and not self.failed

    @property
    def reached(self) -> int:
        """Number of steps that have converged."""
        return len(self.samples)

    def keep(self, samples: PressSamples, place: int, steps: int):
        """Keep one of several samples. Each of its large outputs goes into one array for all steps of the path."""
        for name, values in samples.large.items():
            if name not in self.large:
                self.large[name] = np.empty((steps, *values.shape[1:]), values.dtype)
            self.large[name][len(self.samples)] = values[place]
        self.samples.append(PressSample(samples.values, place))


@dataclass(eq=False)
class Press:
    """One press: its indenter, its start, its tries, and how it ended.

    shape : number of the indenter's shape in the scene
    pose : (4, 4) mm at first touch
    touch : m, travel from the given pose to first touch; NaN without a touch
    steps : number of points after which the press ends as planned
    lateral_reach : mm, largest distance of the indenter's points from the press axis
    race : True if the try that completes first counts
    status : how the press ended; None before
    tries : in the order of `STEP_SCALES`; only the kept one after the press has ended
    kept : the try whose samples are the result; None before the press has ended
    seconds : this press's share of the wall time of the presses that ran together
    dropped : True where the result is not needed any more; the press will not end
    """

    shape: int
    pose: np.ndarray
    touch: float
    steps: int
    lateral_reach: float
    race: bool = False
    status: int | None = None
    tries: list[Try] = field(default_factory=list)
    kept: Try | None = None
    seconds: float = 0.0
    dropped: bool = False

    @property
    def samples(self) -> list[PressSample]:
        """Samples of the kept try."""
        return [] if self.kept is None else self.kept.samples

    @property
    def large(self) -> dict[str, np.ndarray]:
        """Large outputs (d, ...) of the kept try by name; empty without a sample."""
        return {} if self.kept is None else self.kept.large

    @property
    def most_tries(self) -> int:
        """Number of tries that the press may have."""
        return len(STEP_SCALES) if self.race else MOST_WITHOUT_A_RACE

    @property
    def all_failed(self) -> bool:
        """True if all tries have ended and failed."""
        return all(each.failed for each in self.tries)

    def next_try(self) -> Try:
        """Begin the next try."""
        self.tries.append(Try(STEP_SCALES[len(self.tries)]))
        return self.tries[-1]

    def decide(self):
        """End the press if its tries decide the result: the first try counts unless it failed, else the second.

        In a ``race`` any try counts that completes before the first, unless a running one has got further. If all tries
        that a press may have have failed, the one that got furthest counts. So the result depends on which try ends
        first only in a race.
        """
        first, *others = self.tries
        reached = max((each.reached for each in self.tries if each.status is None), default=0)
        if first.completed:
            self.kept = first
        elif self.race or first.failed:
            completed = [each for each in others if each.completed and each.reached >= reached]
            self.kept = max(completed, key=lambda each: each.reached, default=None)
        if self.kept is None and self.all_failed and len(self.tries) == self.most_tries:
            self.kept = max(reversed(self.tries), key=lambda each: each.reached)
        if self.kept is not None:
            self.status, self.tries = self.kept.status, [self.kept]


def second_tries(slow: Iterable[Press], none_waits: bool) -> list[Press]:
    """Slow presses with one try, whose second should begin beside it. Without a race it waits until no press waits."""
    return [press for press in slow if len(press.tries) == 1 and (press.race or none_waits)]


def more_tries(slow: Iterable[Press], running: int) -> Iterator[Press]:
    """Yield slow presses whose third or fourth try should begin, once for each try.

    slow : the slowest first
    running : number of running tries
    """
    for press in slow:
        while 2 <= len(press.tries) < press.most_tries and running < FEW_TRIES:
            yield press  # and the try begins
            running += 1
