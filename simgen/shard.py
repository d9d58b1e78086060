"""One task: press a shard's indenters into every sensor and write the shard.

A worker process makes the scene of a sensor once and keeps it between tasks.
"""

import json
import socket
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from simgen.dataset import Dataset, write_shard
from simgen.errors import InputError
from simgen.indenter import load_indenter
from simgen.job import Job
from simgen.plan import Plan, chosen_fluid, chosen_material, chosen_sensor, indenter_identities, sensor_identity
from simgen.press import PressResult, Scene, SolverSettings, press
from simgen.provenance import difference
from simgen.quiet import start_warp

Presser = Callable[[Sequence[int], np.ndarray, np.ndarray], list[PressResult]]
"""(indenter indices, poses in the sensor's frame (b, 4, 4) m, depths (d,) m) -> one result each."""


@dataclass(frozen=True)
class ShardReport:
    """What came of one task; `failed` counts samples not converged, an `error` means nothing was written."""

    shard: int
    presses: int
    failed: int = 0
    seconds: float = 0.0
    seconds_by_sensor: dict[str, float] | None = None
    host: str = ""
    error: str | None = None


def fem_presser(job: Job, sensor_name: str, device: str) -> Presser:
    """Presses of one sensor by finite elements. Its scene is made once and serves all presses."""
    start_warp()
    sensor = chosen_sensor(job, sensor_name)
    settings = SolverSettings(**job.solver.model_dump(exclude={"element"}))
    batch = 1 if device == "cpu" else job.dataset.presses_per_shard
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
    own = {
        "sensors": {name: sensor_identity(job, name, chosen_sensor(job, name)) for name in recorded["sensors"]},
        "indenters": indenter_identities(job),
    }
    if changes := difference(recorded, own):
        raise InputError(
            f"the inputs on {socket.gethostname()} are not the dataset's ({'; '.join(changes)}); give all "
            "workers the same files, and the same meshes by running `simgen mesh` once in a folder they share"
        )


def warm_up(plan: Plan, build: Callable[[Job, str, str], Presser] = fem_presser) -> None:
    """Press once into every sensor, to the first depth, so that all kernels lie compiled in the cache."""
    for sensor in plan.job.sensors:
        pose = np.linalg.inv(plan.arrays[f"{sensor}/pose"][:1]) @ plan.arrays["press/contact_pose"][:1]
        build(plan.job, sensor, plan.device)([0], pose, plan.job.depths_m[:1])


def run_shard(path: Path, shard: int, job: Job, device: str, build=fem_presser) -> ShardReport:
    """Solve all presses of one shard on every sensor and write them.

    Raises `InputError` where this process sees other sensors or indenters than those of the dataset.
    """
    begin = time.perf_counter()
    dataset = Dataset(path)
    presses = dataset.shard_presses(shard)
    rows = slice(presses.start, presses.stop)
    contact_pose = dataset.root["press/contact_pose"][rows]
    indenters = dataset.root["press/indenter"][rows].tolist()
    inputs = json.dumps({key: dataset.attributes[key] for key in ("sensors", "indenters")})
    values: dict[str, np.ndarray] = {}
    seconds = {}
    for sensor in dataset.sensors:
        poses = np.linalg.inv(dataset.root[f"{sensor}/pose"][rows]) @ contact_pose
        results = _presser(build, job, sensor, device, inputs)(indenters, poses, job.depths_m)
        values |= _columns(dataset, sensor, results)
        seconds[sensor] = round(sum(result.seconds for result in results), 3)
    # Where the reference sensor is never touched, press/pose stays at the contact and travels start there.
    first_touch = np.nan_to_num(values[f"{dataset.sensors[0]}/touch"])
    for sensor in dataset.sensors:
        values[f"{sensor}/touch"] -= first_touch
    values["press/pose"] = _advance(contact_pose, first_touch)
    write_shard(dataset, shard, values)
    failed = sum(int(np.count_nonzero(values[f"{sensor}/status"])) for sensor in dataset.sensors)
    return ShardReport(
        shard, len(presses), failed, round(time.perf_counter() - begin, 3), seconds, socket.gethostname()
    )


def _columns(dataset: Dataset, sensor: str, results: Sequence[PressResult]) -> dict[str, np.ndarray]:
    """Results of a shard as those arrays that the dataset has for the sensor."""
    columns = {}
    for name in dataset.arrays:
        owner, *group, key = name.split("/")
        if owner == sensor:
            found = [result.certificate[key] if group else getattr(result, key) for result in results]
            columns[name] = np.stack(found)
    return columns


def _advance(poses: np.ndarray, travel: np.ndarray) -> np.ndarray:
    """Poses (b, 4, 4) moved by travel (b,) m along their own +y."""
    moved = poses.copy()
    moved[:, :3, 3] += travel[:, None] * poses[:, :3, 1]
    return moved
