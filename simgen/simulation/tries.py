"""A press and its tries: one that fails, or does not get on for long, is pressed once more from rest in half steps."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from simgen.simulation.measurements import PressSample

SECOND_TRY = 0.5  # of the steps of the first
# Newton iterations since the last sample, after which a second try begins beside the first where a place is free. A
# press that fails twice takes up to a thousand for each try, and a run ends when its last press ends. Of the paired
# job's 7,740 presses on the DIGIT some 20 need more for a depth (f124716, one H200).
DOUBT = 300


@dataclass(eq=False)
class Try:
    """One way from rest along the path.

    share : of the longest steps that it takes
    samples : its converged steps, without displacements
    displacement : (d, v, 3) m of all steps of the path; None before the first sample
    status : how it ended; None before
    failed : True where the solver failed, so that another try may get further
    """

    share: float
    samples: list[PressSample] = field(default_factory=list)
    displacement: np.ndarray | None = None
    status: int | None = None
    failed: bool = False

    def keep(self, sample: PressSample, steps: int):
        """Keep a sample. Its displacement goes into one array for all steps of the path."""
        displacement = sample.values.pop("displacement")
        if self.displacement is None:
            self.displacement = np.empty((steps, *displacement.shape), displacement.dtype)
        self.displacement[len(self.samples)] = displacement
        self.samples.append(sample)


@dataclass(eq=False)
class Press:
    """One press: the way that it goes, its tries, and how it ended.

    shape : its number in the scene
    pose : (4, 4) mm at first touch
    touch : m, travel to there from where it was placed; NaN where there is none
    steps : points of the path after which it ends as planned
    lateral : mm, how far the indenter reaches from the press axis
    status : how it ended; None before
    tries : one or two; the one that counts alone when the press has ended
    kept : the try that counts, when the press has ended
    seconds : its share in the time of those that were under way with it
    dropped : nobody waits for it any more, and it will not end
    """

    shape: int
    pose: np.ndarray
    touch: float
    steps: int
    lateral: float
    status: int | None = None
    tries: list[Try] = field(default_factory=list)
    kept: Try | None = None
    seconds: float = 0.0
    dropped: bool = False

    @property
    def samples(self) -> list[PressSample]:
        """The samples that count."""
        return [] if self.kept is None else self.kept.samples

    @property
    def displacement(self) -> np.ndarray | None:
        """Displacements (d, v, 3) m of the samples that count; None without any."""
        return None if self.kept is None else self.kept.displacement

    def next_try(self) -> Try:
        """Begin the first try, or the second."""
        self.tries.append(Try(SECOND_TRY if self.tries else 1.0))
        return self.tries[-1]

    def settle(self):
        """End the press where its tries decide: the first counts if it has not failed, else the second.

        Of two that have failed the one that got further counts. So the result does not depend on which of two tries
        under way is the faster.
        """
        first, second = self.tries[0], self.tries[-1]
        if first.status is not None and not first.failed:
            self.kept = first
        elif first.failed and second is not first and second.status is not None:
            self.kept = first if second.failed and len(first.samples) > len(second.samples) else second
        if self.kept is not None:
            self.status, self.tries = self.kept.status, [self.kept]
