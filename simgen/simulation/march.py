"""March of one press: its samples one by one, as they converge, and then its result."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from simgen.geometry.signed_distance import RigidShape
from simgen.simulation.press import PressResult, Scene, begin, checked_path, result_of
from simgen.simulation.tries import Try
from simgen.units import MM_PER_M


@dataclass(frozen=True)
class MarchedSample:
    """A sample of a press under way.

    step : number of the point on the path, from 0
    outputs : values by name, with the shapes, units and meanings of `simgen.config.outputs`; one sample of each
    """

    step: int
    outputs: dict[str, np.ndarray]


class March:
    """One press under way along a path, as `simgen.simulation.press.follow` takes it. Iteration yields the samples.

    touch_pose : (4, 4) m, indenter frame -> sensor frame at first touch; None without a touch

    ::

        march = March(scene, shape, pose, path_m)
        for sample in march:
            print(sample.step, sample.outputs["force"])
        march.result.force

    The first try of a press may fail or be slow. Another try then begins from rest (see `simgen.simulation.tries`), and
    yields the steps from 0 on again. If an earlier try counts in the end, its samples are yielded once more. So the
    newest sample of each step belongs to the result. Only steps that the result has reached count.

    The scene serves one march at a time: a new one ends the one before. Raises `InputError` as `follow` does.
    """

    def __init__(
        self,
        scene: Scene,
        shape: RigidShape,
        pose: np.ndarray,
        path_m: np.ndarray,
        turns_rad: np.ndarray | None = None,
        steps: int | None = None,
        max_force_n: float = math.inf,
    ):
        poses, steps = np.asarray(pose, dtype=float)[None], None if steps is None else np.array([steps])
        path, steps = checked_path(1, poses, path_m, turns_rad, steps, max_force_n)
        self._stepping, [self._press] = begin(scene, [shape], poses, path, steps, max_force_n)
        self._try: Try | None = None  # the try whose samples were yielded last
        self._yielded = 0  # samples of this try
        self.touch_pose = None
        if np.isfinite(self._press.touch):
            self.touch_pose = self._press.pose.copy()
            self.touch_pose[:3, 3] /= MM_PER_M

    @property
    def under_way(self) -> bool:
        """True until the press has ended."""
        return self._stepping.remaining > 0

    def advance(self) -> list[MarchedSample]:
        """Advance the press by one Newton iteration. Returns new samples, in order; usually none or one."""
        self._stepping.advance()
        latest = self._press.kept or self._press.tries[-1]
        if latest is not self._try:
            self._try, self._yielded = latest, 0
        first, self._yielded = self._yielded, len(latest.samples)
        return [
            MarchedSample(
                step, latest.samples[step].values | {name: large[step] for name, large in latest.large.items()}
            )
            for step in range(first, self._yielded)
        ]

    def __iter__(self) -> Iterator[MarchedSample]:
        while self.under_way:
            yield from self.advance()

    @property
    def result(self) -> PressResult:
        """The result, with the same bytes as that of `follow`; valid once the press has ended."""
        return result_of(self._stepping, self._press)
