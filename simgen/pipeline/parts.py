"""Parts of shards: the presses of a shard on one sensor, and the shard that its parts make.

Parts of a shard can be solved by different processes. So a GPU that is done with its presses on one sensor takes more
of those on the next, and all GPUs end together.
"""

import socket
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from simgen.dataset.atomic_files import Aside, put_in_place
from simgen.dataset.reader import Dataset
from simgen.dataset.writer import manifest_aside, write_aside
from simgen.fem.nonlinear.status import Status, is_failure, is_planned_end
from simgen.pipeline.shard_files import Failure
from simgen.pipeline.shard_writer import ShardWriter, touch_name, travel

THREADS = 4  # a shard has a hundred folders to flush, which takes 20 to 40 ms beside an H200


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
class Part:
    """The presses of one shard on some sensors, solved.

    touch : sensor -> (n,) m, travel to first touch, NaN without one
    files : of the sensors' arrays by path, not in place yet; empty for whole shards
    outcomes : status -> number of samples that are not valid
    seconds : the shard's share of its task's time
    seconds_by_sensor : sensor -> seconds of solving
    failure : why nothing was written, or None
    """

    shard: int
    presses: int
    touch: dict[str, np.ndarray]
    files: dict[str, Aside]
    outcomes: Counter
    seconds: float
    seconds_by_sensor: dict[str, float]
    host: str
    failure: Failure | None

    @classmethod
    def of(cls, writer: ShardWriter, files: dict[str, Aside], seconds_per_press: float) -> "Part":
        """Describe what a writer has written."""
        count = len(writer.presses)
        return cls(writer.shard, count, writer.touch, files, writer.outcomes, seconds_per_press * count,
                   writer.seconds, socket.gethostname(), writer.failure)  # fmt: skip


def whole_report(parts: Sequence[Part]) -> ShardReport:
    """Report on a shard from its parts: all of them, unless one has failed."""
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
    """Puts the shards of a dataset together from their parts. Threads put files in place.

    folder : for unfinished files, those of the parts too
    """

    def __init__(self, dataset: Dataset, folder: Path):
        self._dataset, self._folder, self._parts = dataset, folder, {}
        self._threads, self._placing = ThreadPoolExecutor(THREADS), []

    def add(self, part: Part) -> list[ShardReport]:
        """Add a part. Returns reports on shards that are in place since the last call, or have failed."""
        if part.failure:
            return [whole_report([part]), *self._placed()]
        parts = self._parts.setdefault(part.shard, [])
        parts.append(part)
        if sum(len(each.touch) for each in parts) == len(self._dataset.sensors):
            self._placing.append(self._threads.submit(self._put_together, self._parts.pop(part.shard)))
        return self._placed()

    def rest(self) -> list[ShardReport]:
        """Wait until all complete shards are in place; returns reports on them."""
        wait(self._placing)
        return self._placed()

    def close(self):
        """Wait for what is being put in place, and drop the rest."""
        self._threads.shutdown(cancel_futures=True)

    def _placed(self) -> list[ShardReport]:
        done = [placing for placing in self._placing if placing.done()]
        self._placing = [placing for placing in self._placing if placing not in done]
        return [placing.result() for placing in done]

    def _put_together(self, parts: Sequence[Part]) -> ShardReport:
        """Write what needs the touch of two sensors, and put the shard's files in place, its manifest last."""
        dataset, shard = self._dataset, parts[0].shard
        touch = {sensor: own for part in parts for sensor, own in part.touch.items()}
        reference, *others = dataset.sensors
        values = {touch_name(sensor): travel(touch[sensor], touch[reference]) for sensor in others}
        try:
            files = write_aside(dataset, shard, values, self._folder)
            for part in parts:
                files |= part.files
            manifest = manifest_aside(shard, files, self._folder)
            put_in_place(dataset.path, files)
            put_in_place(dataset.path, manifest)
        except Exception as error:
            return whole_report([replace(parts[0], failure=Failure.of(error))])
        return whole_report(parts)
