"""A press and its tries: a press whose first try fails or is slow is solved once more from rest in half steps."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from simgen.simulation.measurements import PressSample, PressSamples

SECOND_TRY_SCALE = 0.5  # longest load step of the second try over that of the first
# Newton iterations since the last sample, after which the second try begins beside the first if an environment is free,
# and the same for the iterations of a whole try. A run ends when its last press ends. Computed from both tries of slow
# cubes and rings on the DIGIT, that would be after 1,031 to 1,383 iterations if the try that ends first counts. With
# 300 and 450 it would be after 1,181 to 1,483, and after 1,328 to 1,762 if the first try counts unless it fails (four
# runs on H200s, `docs/benchmarks/two_tries_h200.json`).
SECOND_TRY_ITERATIONS = 150
SECOND_TRY_AFTER = 350


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
    tries : one or two; only the kept one after the press has ended
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

    def next_try(self) -> Try:
        """Begin the first try, or the second."""
        self.tries.append(Try(SECOND_TRY_SCALE if self.tries else 1.0))
        return self.tries[-1]

    def decide(self):
        """End the press if its tries decide the result: the first try counts unless it failed, else the second.

        In a ``race`` a second try also counts if it completes before the first, and has got as far. If both failed, the
        one that got further counts. So the result depends on which try ends first only in a race.
        """
        first, second = self.tries[0], self.tries[-1]
        if first.completed:
            self.kept = first
        elif self.race and second.completed and len(second.samples) >= len(first.samples):
            self.kept = second
        elif first.failed and second is not first and second.status is not None:
            self.kept = first if second.failed and len(first.samples) > len(second.samples) else second
        if self.kept is not None:
            self.status, self.tries = self.kept.status, [self.kept]
