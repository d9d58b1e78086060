"""One task: press the indenters of some shards into every sensor and write the shards.

A worker process makes the scene of a sensor once and keeps it between tasks. What one sensor made is written while the
next one is solved; a worker with two threads begins the next task meanwhile.
"""

import json
import os
import socket
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from simgen.capacity import presses_at_once
from simgen.dataset import Dataset, commit_shards, write_aside
from simgen.errors import InputError
from simgen.indenter import load_indenter
from simgen.job import Job
from simgen.plan import chosen_fluid, chosen_material, chosen_sensor, indenter_identities, sensor_identity
from simgen.press import PressResult, Scene, SolverSettings, press
from simgen.provenance import difference
from simgen.quiet import start_warp
from simgen.sensor import Sensor
from simgen.whole_files import Aside

Presser = Callable[[Sequence[int], np.ndarray, np.ndarray], list[PressResult]]
"""(indenter indices, poses in the sensor's frame (b, 4, 4) m, depths (d,) m) -> one result each."""

WRITTEN_AT_ONCE = min(16, os.cpu_count() or 1)  # shards: each takes 0.2 s of a core and 0.1 GB a sensor
SOLVING = threading.Lock()  # one task of a process solves, others read and write


@dataclass(frozen=True)
class ShardReport:
    """What came of one shard; `failed` counts samples not converged, an `error` means nothing was written."""

    shard: int
    presses: int
    failed: int = 0
    seconds: float = 0.0
    seconds_by_sensor: dict[str, float] | None = None
    host: str = ""
    error: str | None = None


@lru_cache(maxsize=8)
def _sensor(job: Job, name: str) -> Sensor:
    """One sensor per process: to cut its regions and place its core takes a second."""
    return chosen_sensor(job, name)


def fem_presser(job: Job, sensor_name: str, device: str) -> Presser:
    """Presses of one sensor by finite elements. Its scene is made once and serves all presses."""
    start_warp()
    sensor = _sensor(job, sensor_name)
    settings = SolverSettings(**job.solver.model_dump(exclude={"element"}))
    batch = presses_at_once(sensor, device, job.solver.element, settings)
    material, fluid = chosen_material(job, sensor_name, sensor), chosen_fluid(job, sensor_name, sensor)
    scene = Scene(sensor, material, job.solver.element, device, batch, settings, fluid)
    shapes = [load_indenter(job.locate(text)).shape() for text in job.indenters]

    def presser(indenters: Sequence[int], poses: np.ndarray, depths_m: np.ndarray) -> list[PressResult]:
        return press(scene, [shapes[i] for i in indenters], poses, depths_m)

    return presser


@lru_cache(maxsize=8)
def _presser(
    build: Callable[[Job, str, str], Presser], job: Job, sensor: str, device: str, inputs: str
) -> Presser:
    """One presser per sensor, worker process and inputs of the dataset, kept between tasks."""
    _check_inputs(job, inputs)
    return build(job, sensor, device)


@lru_cache(maxsize=8)
def _check_inputs(job: Job, inputs: str) -> None:
    """Raises `InputError` where a sensor or an indenter is another one here than in the dataset.

    `inputs` is JSON of the dataset's attributes. Files may differ between machines, and so do meshes that each
    made for itself: fTetWild does not make the same mesh twice.
    """
    recorded = json.loads(inputs)
    _sensor.cache_clear()  # its files may be others than when this process solved for another dataset
    own = {
        "sensors": {name: sensor_identity(job, name, _sensor(job, name)) for name in recorded["sensors"]},
        "indenters": indenter_identities(job),
    }
    if changes := difference(recorded, own):
        raise InputError(
            f"the inputs on {socket.gethostname()} are not the dataset's ({'; '.join(changes)}); give all "
            "workers the same files, and the same meshes by running `simgen mesh` once in a folder they share"
        )


def run_shards(path: Path, shards: Sequence[int], job: Job, device: str, build=fem_presser) -> list[ShardReport]:
    """Solve all presses of some shards on every sensor and write them, each by itself.

    Raises `InputError` where this process sees other sensors or indenters than those of the dataset. What goes wrong
    with one shard alone stands in its report.
    """
    dataset = Dataset(path)
    with ThreadPoolExecutor(WRITTEN_AT_ONCE) as threads:
        presses = [np.array(dataset.shard_presses(shard)) for shard in shards]
        rows, ends = np.concatenate(presses), np.cumsum([len(some) for some in presses])
        contact_pose = dataset.root["press/contact_pose"][:][rows]
        poses_of = np.split(contact_pose, ends[:-1])
        writers = [_ShardWriter(dataset, *each, threads) for each in zip(shards, poses_of, strict=True)]
        indenters = dataset.root["press/indenter"][:][rows].tolist()
        inputs = json.dumps({key: dataset.attributes[key] for key in ("sensors", "indenters")})
        with SOLVING:
            begin = time.perf_counter()
            for sensor in dataset.sensors:
                poses = np.linalg.inv(dataset.root[f"{sensor}/pose"][:][rows]) @ contact_pose
                results = _presser(build, job, sensor, device, inputs)(indenters, poses, job.depths_m)
                for writer, end in zip(writers, ends, strict=True):
                    writer.take(sensor, results[end - len(writer.contact_pose) : end])
                del results  # gigabytes, of which each shard lets go when it has written them
        return _commit(dataset, writers, begin)


class _ShardWriter:
    """Writes what a sensor made of a shard's presses (n,) while the next sensor is solved."""

    def __init__(self, dataset: Dataset, shard: int, contact_pose: np.ndarray, threads: ThreadPoolExecutor):
        self.dataset, self.shard, self.contact_pose = dataset, shard, contact_pose
        self._threads, self._asides = threads, []
        self._failed, self._seconds, self._first_touch = 0, {}, np.zeros(len(contact_pose))

    def take(self, sensor: str, results: list[PressResult]) -> None:
        """Begin to write the results (n,) of a sensor aside; those of the reference sensor come first."""
        dataset, touch = self.dataset, np.array([result.touch for result in results])
        values = _columns(dataset, sensor, results)
        if sensor == dataset.sensors[0]:
            # Where the reference sensor is never touched, press/pose stays at the contact and travels start there.
            self._first_touch = np.nan_to_num(touch)
            values["press/pose"] = _advance(self.contact_pose, self._first_touch)
        values[f"{sensor}/touch"] = touch - self._first_touch
        self._failed += sum(int(np.count_nonzero(result.status)) for result in results)
        self._seconds[sensor] = round(sum(result.seconds for result in results), 3)
        self._asides.append(self._threads.submit(write_aside, dataset, self.shard, values))

    def files(self) -> dict[str, Aside]:
        """All that has been written aside, by path. Raises what went wrong with any of it."""
        return {path: file for aside in self._asides for path, file in aside.result().items()}

    def report(self, seconds_per_press: float, error: str | None) -> ShardReport:
        count = len(self.contact_pose)
        if error:
            return ShardReport(self.shard, count, error=error)
        seconds = round(seconds_per_press * count, 3)
        return ShardReport(self.shard, count, self._failed, seconds, self._seconds, socket.gethostname())


def _commit(dataset: Dataset, writers: Sequence[_ShardWriter], begin: float) -> list[ShardReport]:
    """Put shards in their places. One that could not be written does not take the others with it."""
    shards, errors = {}, {}
    for writer in writers:
        try:
            shards[writer.shard] = writer.files()
        except Exception as error:
            errors[writer.shard] = f"{type(error).__name__}: {error}"
    commit_shards(dataset, shards)
    seconds = (time.perf_counter() - begin) / sum(len(writer.contact_pose) for writer in writers)
    return [writer.report(seconds, errors.get(writer.shard)) for writer in writers]


def _columns(dataset: Dataset, sensor: str, results: Sequence[PressResult]) -> dict[str, list]:
    """Results of a shard as those arrays that the dataset has for the sensor, a press at a time."""
    columns = {}
    for name in dataset.arrays:
        owner, *group, key = name.split("/")
        if owner == sensor:
            columns[name] = [result.certificate[key] if group else getattr(result, key) for result in results]
    return columns


def _advance(poses: np.ndarray, travel: np.ndarray) -> np.ndarray:
    """Poses (b, 4, 4) moved by travel (b,) m along their own +y."""
    moved = poses.copy()
    moved[:, :3, 3] += travel[:, None] * poses[:, :3, 1]
    return moved
