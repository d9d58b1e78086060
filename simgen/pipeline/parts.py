"""Parts of shards: the presses of a shard on one sensor, and the shard that its parts make.

Parts of a shard can be solved by different processes. So a GPU that is done with its presses on one sensor takes more
of those on the next, and all GPUs end together.
"""

import socket
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from simgen.dataset.atomic_files import put_in_place
from simgen.dataset.reader import Dataset
from simgen.dataset.writer import manifest_of_sums, write_aside
from simgen.fem.nonlinear.status import Status, is_failure, is_planned_end
from simgen.pipeline.shard_files import Failure
from simgen.pipeline.shard_writer import ShardWriter, touch_name, travel


@dataclass(frozen=True)
class ShardReport:
    """Outcome of one shard; an `error` means that nothing was written.

    failed, planned, inside_out : numbers of samples, over all sensors: failed; not pressed, as planned; converged with
        an inverted element
    seconds : the shard's share of its tasks' time, from the first press to the last file. Tasks of threads overlap
    errno : the operating system's number of the error, if there is one
    """

    shard: int
    presses: int
    failed: int = 0
    planned: int = 0
    inside_out: int = 0
    seconds: float = 0.0
    seconds_by_sensor: dict[str, float] | None = None
    host: str = ""
    error: str | None = None
    errno: int | None = None


@dataclass(frozen=True)
class PartReport:
    """Outcome of one shard on some sensors.

    touch : sensor -> (n,) m, travel to first touch, NaN without one
    sums : sha256 of the files in place, by path
    outcomes : status -> number of samples that are not valid
    seconds : the shard's share of its task's time
    seconds_by_sensor : sensor -> seconds of solving
    failure : why nothing was written, or None
    """

    shard: int
    presses: int
    touch: dict[str, np.ndarray]
    sums: dict[str, str]
    outcomes: Counter
    seconds: float
    seconds_by_sensor: dict[str, float]
    host: str
    failure: Failure | None

    @classmethod
    def of(cls, writer: ShardWriter, seconds_per_press: float) -> "PartReport":
        """Report on what a writer has put in place."""
        count = len(writer.presses)
        return cls(writer.shard, count, writer.touch, writer.sums, writer.outcomes, seconds_per_press * count,
                   writer.seconds, socket.gethostname(), writer.failure)  # fmt: skip


def whole_report(parts: Sequence[PartReport]) -> ShardReport:
    """Report on a shard from the reports on its parts: all of them, unless one has failed."""
    first = parts[0]
    if failure := next((part.failure for part in parts if part.failure), None):
        return ShardReport(first.shard, first.presses, error=failure.sentence, errno=failure.errno)
    samples = sum((part.outcomes for part in parts), Counter())
    failed = sum(number for code, number in samples.items() if is_failure(code))
    planned = sum(number for code, number in samples.items() if is_planned_end(code))
    counts = (failed, planned, samples[Status.INSIDE_OUT])
    seconds = round(sum(part.seconds for part in parts), 3)
    by_sensor = {sensor: own for part in parts for sensor, own in part.seconds_by_sensor.items()}
    return ShardReport(first.shard, first.presses, *counts, seconds, by_sensor, first.host)


class Parts:
    """Puts the shards of a dataset together from their parts. ``folder`` is for unfinished files."""

    def __init__(self, dataset: Dataset, folder: Path):
        self._dataset, self._folder, self._parts = dataset, folder, {}

    def add(self, part: PartReport) -> ShardReport | None:
        """Add a part, and return the report on its shard if that is complete or cannot be written.

        A complete shard gets its manifest.
        """
        if part.failure:
            return whole_report([part])
        parts = self._parts.setdefault(part.shard, [])
        parts.append(part)
        if sum(len(each.touch) for each in parts) < len(self._dataset.sensors):
            return None
        del self._parts[part.shard]
        try:
            self._put_together(parts)
        except OSError as error:
            return whole_report([replace(part, failure=Failure.of(error))])
        return whole_report(parts)

    def _put_together(self, parts: Sequence[PartReport]):
        """Write what needs the touch of two sensors, and the manifest."""
        dataset, shard = self._dataset, parts[0].shard
        touch = {sensor: own for part in parts for sensor, own in part.touch.items()}
        reference, *others = dataset.sensors
        values = {touch_name(sensor): travel(touch[sensor], touch[reference]) for sensor in others}
        files = write_aside(dataset, shard, values, self._folder)
        sums = {path: found for part in parts for path, found in part.sums.items()}
        sums |= {path: file.sha256 for path, file in files.items()}
        put_in_place(dataset.path, files)
        put_in_place(dataset.path, manifest_of_sums(shard, sums, self._folder))
