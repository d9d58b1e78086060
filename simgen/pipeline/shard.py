"""A task of a run: solve the presses of some shards on every sensor, or on one, and write their files.

A worker process makes the scene of a sensor once and keeps it between tasks. Threads of a worker share it (see
`simgen.simulation.pool`). Results of one sensor are written while the next sensor is solved.
"""

import json
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

import simgen
from simgen.config.job_schema import Job
from simgen.config.warp_device import start_warp
from simgen.dataset.provenance import difference, package_versions, source_hash
from simgen.dataset.reader import Dataset
from simgen.dataset.writer import folder_aside
from simgen.errors import InputError
from simgen.fem.device import DEVICE
from simgen.fem.material import LAWS
from simgen.fem.material.law import Law
from simgen.pipeline.parts import Part, ShardReport, whole_report
from simgen.pipeline.plan import chosen_material, indenter_identities, sensor_identity
from simgen.pipeline.presser import POOLS_BY_SENSOR, Presser, fem_presser, loaded_indenters, loaded_sensor
from simgen.pipeline.shard_files import version_of, writing
from simgen.pipeline.shard_writer import ShardWriter, put_shards_in_place
from simgen.simulation.kernel_loading import load_kernels, load_press_kernels

# Versions at the start of the process: files may change while a worker lives, its loaded code does not.
LOADED_VERSIONS = {"code": {"version": simgen.__version__, "source": source_hash()}, "packages": package_versions()}


def _laws(job: Job) -> set[type[Law]]:
    """Material laws of the job's sensors."""
    return {LAWS[chosen_material(job, name, loaded_sensor(job, name)).law] for name in job.sensors}


_MAKING = threading.Lock()  # guards the caches of inputs and pressers; a thread takes it before `DEVICE`


@lru_cache(maxsize=8)
def _presser(
    build: Callable[[Job, str, str], Presser], job: Job, sensor: str, device: str, inputs: str
) -> Presser:
    """The presser of a sensor, kept between tasks while `inputs` are the same.

    A GPU's process of a dask scheduler, or one that replaces a dead process, is not prepared and gets hundreds of tasks
    at once. Without `_MAKING`, several threads would make pressers at the same time, until no memory is left.
    """
    with DEVICE.with_rank(0):  # new presses keep the device busy
        return build(job, sensor, device)


@lru_cache(maxsize=1)
def _inputs(job: Job, sensors: tuple[str, ...]) -> str:
    """Identities of the loaded sensors, indenters, code and packages: JSON in the form of the dataset's attributes."""
    with DEVICE.with_rank(0):
        own = {
            **LOADED_VERSIONS,
            "sensors": {name: sensor_identity(job, name, loaded_sensor(job, name)) for name in sensors},
            "indenters": indenter_identities(loaded_indenters(job)),
        }
    return json.dumps(own, sort_keys=True)


def recorded_inputs(attributes: Mapping[str, Any]) -> str:
    """Inputs that the dataset records, in the form of `_inputs`: those at the time of the plan."""
    own = {key: attributes[key] for key in ("sensors", "indenters", "packages")}
    code = {key: attributes["code"][key] for key in LOADED_VERSIONS["code"]}  # without the commit, which a wheel lacks
    return json.dumps({**own, "code": code}, sort_keys=True)


def _check_inputs(job: Job, recorded: str) -> None:
    """Raise `InputError` if a sensor, an indenter, a package or the code here differs from the dataset's.

    `recorded` is the result of `recorded_inputs`. Other machines may have other files and versions. Each has other
    meshes if it made them itself, because fTetWild never makes the same mesh twice.
    """
    sensors = tuple(json.loads(recorded)["sensors"])
    if _inputs(job, sensors) == recorded:
        return
    for read in (loaded_sensor, loaded_indenters, _inputs):  # files may have changed since this process read them
        read.cache_clear()
    if changes := difference(json.loads(recorded), json.loads(_inputs(job, sensors))):
        raise InputError(
            f"the inputs on {socket.gethostname()} differ from the dataset's ({'; '.join(changes)}); give all workers "
            "the same code and files, start them again after a change, and make meshes once in a folder they share "
            "(`simgen mesh`)"
        )


@dataclass(frozen=True)
class PlannedPresses:
    """The planned presses of a dataset.

    indenter (press,); contact_pose and each sensor_pose (press, 4, 4) m; steps (press,) by sensor, or {} if the job
    does not stop presses early
    """

    dataset: Dataset
    indenter: np.ndarray
    contact_pose: np.ndarray
    sensor_pose: dict[str, np.ndarray]
    steps: dict[str, np.ndarray]


_READING = threading.Lock()


def _planned(path: Path, job: Job) -> PlannedPresses:
    """Read the plan once for all tasks of this process: hundreds may begin at the same time."""
    version = version_of(path)
    with _READING:
        return _read_plan(path, job, version)


@lru_cache(maxsize=1)
def _read_plan(path: Path, job: Job, version: tuple[int, int] | None) -> PlannedPresses:
    """Read the plan; `version` is the result of `version_of`."""
    dataset = Dataset(path)
    poses = {sensor: dataset.root[f"{sensor}/pose"][:] for sensor in dataset.sensors}
    steps = {sensor: dataset[f"{sensor}/pressable_steps"] for sensor in dataset.sensors if dataset.job.stops_early}
    return PlannedPresses(
        dataset, dataset.root["press/indenter"][:], dataset.root["press/contact_pose"][:], poses, steps
    )


def prepare(
    job: Job, device: str, build: Callable[[Job, str, str], Presser] = fem_presser, part: int = 0, parts: int = 1
) -> None:
    """Make all pressers of a job before its tasks: sensors, scenes, and most kernels.

    A GPU's kernels compile while sensors load. ``parts`` CPU processes that start together compile different kernels.
    """
    start_warp()
    with _MAKING, ThreadPoolExecutor(1) as beside:
        loading = beside.submit(load_kernels, device)
        inputs = _inputs(job, tuple(sorted(job.sensors)))
        loading.result()
        if build is fem_presser:  # others launch no kernels
            with DEVICE.with_rank(0):
                load_press_kernels(device, _laws(job), part, parts)
        for sensor in job.sensors:
            _presser(build, job, sensor, device, inputs)


def run_shards(path: Path, shards: Sequence[int], job: Job, device: str, build=fem_presser) -> list[ShardReport]:
    """Solve all presses of some shards on every sensor, and write the shards.

    Raises `InputError` if sensors, indenters, code or packages of this process differ from the dataset's. If one shard
    cannot be written, its report says why.
    """
    plan = _planned(path, job)
    with folder_aside(plan.dataset) as folder:
        begin = time.perf_counter()
        with _solved(plan, shards, job, device, build, plan.dataset.sensors, folder) as writers:
            put_shards_in_place(plan.dataset, writers)
    share = (time.perf_counter() - begin) / sum(len(writer.presses) for writer in writers)
    return [whole_report([Part.of(writer, {}, share)]) for writer in writers]


def run_parts(
    path: Path, shards: Sequence[int], job: Job, device: str, build, sensor: str, folder: Path
) -> list[Part]:
    """Solve all presses of some shards on one sensor, and write its files into a folder aside. Raises as `run_shards`.

    `simgen.pipeline.parts.Parts` puts the files in place. So a task that is solved twice, because a process has died,
    does no harm.
    """
    begin = time.perf_counter()
    with _solved(_planned(path, job), shards, job, device, build, [sensor], folder) as writers:
        files = [writer.arrays() for writer in writers]
    share = (time.perf_counter() - begin) / sum(len(writer.presses) for writer in writers)
    return [Part.of(writer, own, share) for writer, own in zip(writers, files, strict=True)]


# Tasks of `run_parts` whose presses have been added in this process, by the folder of their run and the sensor.
BEGUN: Counter[tuple[Path, str]] = Counter()
_COUNTING = threading.Lock()


def room_for_parts(sensors: Sequence[str], presses_per_task: int, folder: Path) -> tuple[int, int] | None:
    """Number of a run's tasks on these sensors that have begun in this process, and of those for which there is room.

    None if the process has not pressed all of these sensors by finite elements.
    """
    there = [POOLS_BY_SENSOR.get(sensor) for sensor in sensors]
    if None in there:
        return None
    rooms = [max(0, -(-pools.room // presses_per_task)) for pools in there]
    with _COUNTING:
        return sum(BEGUN[folder, sensor] for sensor in sensors), len(rooms) * min(rooms)


@contextmanager
def _solved(
    plan: PlannedPresses, shards: Sequence[int], job: Job, device: str, build, sensors: Sequence[str], folder: Path
) -> Iterator[list[ShardWriter]]:
    """Yield writers of the shards that have the results of some sensors."""
    with writing() as threads:
        writers = [ShardWriter(plan.dataset, shard, folder, threads) for shard in shards]
        try:
            _solve(plan, writers, job, device, build, sensors, folder)
            yield writers
        except BaseException:
            for writer in writers:
                writer.abandon()
            raise


def _solve(
    plan: PlannedPresses, writers: Sequence[ShardWriter], job: Job, device: str, build, sensors: Sequence[str],
    folder: Path,
) -> None:  # fmt: skip
    """Solve the presses of all shards on some sensors, and pass the results to the shards' writers."""
    dataset, rows = plan.dataset, np.concatenate([writer.presses for writer in writers])
    ends = np.cumsum([len(writer.presses) for writer in writers])
    contact_pose, indenters = plan.contact_pose[rows], plan.indenter[rows].tolist()
    inputs = recorded_inputs(dataset.attributes)
    with _MAKING:
        _check_inputs(job, inputs)
        pressers = {sensor: _presser(build, job, sensor, device, inputs) for sensor in sensors}
    under_way = {}
    for sensor, presser in pressers.items():
        poses = np.linalg.inv(plan.sensor_pose[sensor][rows]) @ contact_pose
        limits = [plan.steps[sensor][rows]] if plan.steps else []
        under_way[sensor] = presser(indenters, poses, *limits)
        with _COUNTING:
            BEGUN[folder, sensor] += 1
    for sensor in sensors:
        results = list(under_way.pop(sensor))
        for writer, end in zip(writers, ends, strict=True):
            own = slice(end - len(writer.presses), end)
            writer.take(sensor, results[own], contact_pose[own])
        del results  # gigabytes: each writer frees its own part
