"""Writes the results of a shard, sensor by sensor, while the next sensor is solved."""

from collections import Counter
from collections.abc import Sequence
from concurrent.futures import wait
from pathlib import Path

import numpy as np

from simgen.dataset.atomic_files import Aside, holds, put_in_place
from simgen.dataset.reader import Dataset
from simgen.dataset.writer import forget, manifest_aside, manifest_path
from simgen.fem.nonlinear.status import is_valid
from simgen.pipeline.shard_files import Failure, WritingThreads
from simgen.sensors.indenter_pose import advanced
from simgen.simulation.press import PressResult


class ShardWriter:
    """Writes one shard's files into a folder aside, for all sensors or some.

    presses : (n,) numbers of the shard's presses
    touch : sensor -> (n,) m, travel to first touch, NaN without one
    outcomes : status -> number of samples that are not valid, of all sensors
    seconds : sensor -> seconds of solving
    failure : the first sensor's error in writing, or None; known once `files` or `arrays` has returned
    """

    def __init__(self, dataset: Dataset, shard: int, folder: Path, threads: WritingThreads):
        self.dataset, self.shard, self.presses = dataset, shard, np.array(dataset.shard_presses(shard))
        self.outcomes, self.seconds, self.failure = Counter(), {}, None
        self._folder, self._threads, self._writing = folder, threads, []
        self.touch: dict[str, np.ndarray] = {}

    def take(self, sensor: str, results: Sequence[PressResult], contact_pose: np.ndarray) -> None:
        """Begin to write the results (n,) of a sensor; the reference sensor must come first, if it comes at all.

        contact_pose (n, 4, 4): indenter frame -> shared frame, m.
        """
        dataset, reference = self.dataset, self.dataset.sensors[0]
        self.touch[sensor] = np.array([result.touch for result in results])
        values = _columns(dataset, sensor, results)
        if sensor == reference:
            values["press/pose"] = advanced(contact_pose, np.nan_to_num(self.touch[sensor]))
        if reference in self.touch:
            values[touch_name(sensor)] = travel(self.touch[sensor], self.touch[reference])
        self.outcomes.update(int(code) for result in results for code in result.status[~is_valid(result.status)])
        self.seconds[sensor] = round(sum(result.seconds for result in results), 3)
        self._writing.append(self._threads.submit(dataset, self.shard, values, self._folder))

    def files(self) -> tuple[dict[str, Aside], dict[str, Aside]]:
        """Wait for the shard's files and manifest, by path; both are empty after a failure."""
        files = self.arrays()
        if self.failure is None:
            try:
                return files, manifest_aside(self.shard, files, self._folder)
            except OSError as error:
                self.failure = Failure.of(error)
        return {}, {}

    def arrays(self) -> dict[str, Aside]:
        """Wait for the files of the arrays, by path; empty after a failure."""
        files: dict[str, Aside] = {}
        for writing in self._writing:
            written = writing.result()
            if isinstance(written, Failure):
                self.failure = self.failure or written
            else:
                files |= written
        return files if self.failure is None else {}

    def abandon(self):
        """Write no more files, and wait for those that are being written."""
        for writing in self._writing:
            writing.cancel()
        wait(self._writing)


def put_shards_in_place(dataset: Dataset, writers: Sequence[ShardWriter]) -> None:
    """Put the files of all shards without failure in place, manifests last."""
    files, manifests = {}, {}
    for writer in writers:
        of_shard, manifest = writer.files()
        files |= of_shard
        manifests |= manifest
    # The old manifest of a shard that is solved again is wrong while other files replace its own. It stays if the files
    # are the same: dask may solve a shard twice when processes die, and a later death must not undo the first success.
    changed = [path for path, manifest in manifests.items() if not holds(dataset.path / path, manifest)]
    forget(dataset, [writer.shard for writer in writers if manifest_path(writer.shard) in changed])
    put_in_place(dataset.path, files)
    put_in_place(dataset.path, manifests)


def touch_name(sensor: str) -> str:
    """Name of the array of a sensor's travel to first touch."""
    return f"{sensor}/touch"


def travel(touch: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Travel (n,) m to first touch of a sensor, counted from first touch of the reference sensor.

    If a press never touches the reference sensor, press/pose stays at the contact, and travel counts from it.
    """
    return touch - np.nan_to_num(reference)


def _columns(dataset: Dataset, sensor: str, results: Sequence[PressResult]) -> dict[str, Sequence]:
    """Collect a sensor's results in the dataset's arrays, press by press."""
    kept = (output.name for output in dataset.job.kept_outputs(sensor))
    return {f"{sensor}/{name}": [result.outputs[name] for result in results] for name in kept}
