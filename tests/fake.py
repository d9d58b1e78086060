"""Stand-ins that make a whole dataset in a second: a plan on a coarse ball, a press by formula."""

import hashlib
import json
import os
import signal
import tempfile
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import trimesh
import zarr

from simgen.config.job import job_from_dict
from simgen.config.job_schema import Job
from simgen.config.outputs import OUTPUTS, PIXEL_COLUMN, PIXEL_ROW, SURFACE_VERTEX, VERTEX
from simgen.dataset.provenance import code_version, package_versions
from simgen.dataset.reader import Dataset
from simgen.dataset.splits import number_presses, split_presses
from simgen.dataset.stored_arrays import path_arrays
from simgen.pipeline.plan import indenter_identities
from simgen.sensors.indenter import chosen_indenters
from simgen.simulation.press import PressResult

RADIUS_M = 7e-3
BALL = trimesh.creation.icosphere(subdivisions=3, radius=RADIUS_M)
VERTICES = np.asarray(BALL.vertices)
HELD = VERTICES[:, 1] > 0.5 * RADIUS_M
LENGTHS = {VERTEX: len(VERTICES), SURFACE_VERTEX: 0, PIXEL_ROW: 4, PIXEL_COLUMN: 3}
FILLED = {"digit": {"model": "digit"}, "biotac": {"model": "biotac", "fluid": "incompressible"}}


def make_job(**changes) -> Job:
    plain = {
        "name": "fake",
        "seed": 3,
        "sensors": {"digit": {"model": "digit"}, "biotac": {"model": "biotac"}},
        "indenters": ["sphere_7mm", "ring_7mm", "texture_14mm"],
        "trajectories": {"count": 4},
        "depths_mm": {"first": 0.1, "last": 0.4, "count": 4},
        "dataset": {"presses_per_shard": 2},
    }
    return job_from_dict({**plain, **changes})


def make_plan(job: Job) -> SimpleNamespace:
    """As `simgen.pipeline.plan.make_plan`, with contacts around the pole at -y and both sensors in the same place."""
    count = job.trajectories.count
    trajectory, indenter = number_presses(job)
    normals = np.random.default_rng(job.seed).normal(size=(count, 3)) * [0.3, 0.1, 0.3] - [0.0, 1.0, 0.0]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    side = np.cross(normals, [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    contact = np.tile(np.eye(4), (count, 1, 1))
    contact[:, :3, :3] = np.stack([np.cross(-normals, side), -normals, side], axis=2)
    contact[:, :3, 3] = RADIUS_M * normals
    arrays = {
        **path_arrays(job.indenter_path),
        "press/trajectory": trajectory,
        "press/indenter": indenter,
        "press/split": split_presses(job),
        "press/contact_pose": contact[trajectory],
        "press/contact_normal": normals[trajectory],
    }
    for sensor in job.sensors:
        arrays |= {
            f"{sensor}/rest_positions": VERTICES,
            f"{sensor}/tetrahedra": np.array([[0, 1, 2, 3]], np.int32),
            f"{sensor}/surface_triangles": np.asarray(BALL.faces, np.int32),
            f"{sensor}/held": HELD,
            f"{sensor}/touchable": ~HELD,
            f"{sensor}/pose": np.tile(np.eye(4), (len(trajectory), 1, 1)),
        }
    attributes = {
        "job": job.resolved(),
        "job_hash": job.hash,
        "code": code_version(),
        "packages": package_versions(),
        "sensors": {},  # the ball is no sensor that could be loaded again
        "indenters": indenter_identities(chosen_indenters(job)),
        "status": {"0": "Converged.", "1": "Stalled.", "2": "Never touched.", "7": "Too strong.", "8": "No room.",
                   "9": "Inside out."},
    }
    return SimpleNamespace(job=job, device="cpu", attributes=attributes, arrays=arrays)


def fake_result(indenter: int, pose: np.ndarray, depths: np.ndarray, seconds: float) -> PressResult:
    """Displacement grows with depth and depends on the pose, so every press differs. What has no formula here is 0."""
    near = np.exp(-np.sum((VERTICES - pose[:3, 3]) ** 2, axis=1) / (2e-3 + 1e-3 * indenter) ** 2)
    direction = np.where(HELD, 0.0, near)[:, None] * pose[:3, 1]
    ones = np.ones(len(depths))
    outputs = {output.name: np.zeros((len(depths), *output.shape_of(LENGTHS))) for output in OUTPUTS} | {
        "displacement": depths[:, None, None] * direction,
        "force": depths[:, None] * 1e3 * pose[:3, 1],
        "moment": depths[:, None] * pose[:3, 3],
        "status": np.zeros(len(depths), np.int8),
        "cavity_pressure": 1e6 * depths,
        "shear_force": depths[:, None] * [10.0, -20.0],
        "slip_share": 0.5 * ones,
        "certificate/residual": 1e-6 * ones,
        "certificate/contact_error": 1e-4 * ones,
        "certificate/force_balance": 1e-6 * ones,
        "certificate/min_det_F": 0.9 * ones,
        "certificate/least_det_F": 0.8 * ones,
        "certificate/rms_penetration_m": 1e-6 * ones,
        "certificate/max_penetration_m": 3e-6 * ones,
        "certificate/newton_iterations": 4 * ones,
        "certificate/krylov_iterations": 40 * ones,
        "certificate/substeps": ones,
        "certificate/liquid_volume_error": 1e-9 * ones,
    }
    return PressResult(outputs, 1e-5 * (indenter + 1), seconds)


def fake_presser(job, sensor, device):
    def presser(indenters, poses):
        depths = job.indenter_path.depths_m
        return [fake_result(i, pose, depths, 0.01) for i, pose in zip(indenters, poses, strict=True)]

    return presser


def failing_presser(job, sensor, device):
    """The ring stalls from the third depth on."""

    def presser(indenters, poses):
        results = fake_presser(job, sensor, device)(indenters, poses)
        for indenter, result in zip(indenters, results, strict=True):
            if indenter == 1:
                result.status[2:] = 1
                for values in (
                    result.displacement,
                    result.force,
                    result.moment,
                    *result.certificate.values(),
                ):
                    values[2:] = np.nan
        return results

    return presser


def ending_presser(job, sensor, device):
    """Of three indenters the first reaches a force limit at the last depth, the second has no room from the third
    depth on, and the third is inside out at the second depth.
    """

    def presser(indenters, poses):
        results = fake_presser(job, sensor, device)(indenters, poses)
        for indenter, result in zip(indenters, results, strict=True):
            if indenter == 2:
                result.status[1], result.certificate["inverted_elements"][1] = 9, 4
                continue
            reached, code = ((len(job.indenter_path.depths_m) - 1, 7), (2, 8))[indenter]
            result.status[reached:] = code
            for values in (result.displacement, result.force, result.moment, *result.certificate.values()):
                values[reached:] = np.nan
        return results

    return presser


ESTIMATES = ["surface_error_estimate_m", "force_error_estimate"]


def estimating_presser(job, sensor, device):
    """Estimates of 1, 2 and 3 um at four depths, none at the last, and 1 % of force for each um; twice as many for each
    further indenter.
    """

    def presser(indenters, poses):
        results = fake_presser(job, sensor, device)(indenters, poses)
        for indenter, result in zip(indenters, results, strict=True):
            size = 2.0**indenter * np.array([1.0, 2.0, 3.0, np.nan])
            result.outputs |= dict(zip(ESTIMATES, (1e-6 * size, 0.01 * size), strict=True))
        return results

    return presser


def missing_presser(job, sensor, device):
    """The ring never touches the first sensor."""

    def presser(indenters, poses):
        results = fake_presser(job, sensor, device)(indenters, poses)
        for indenter, result in zip(indenters, results, strict=True):
            if indenter == 1 and sensor == "digit":
                result.touch = np.nan
                result.status[:] = 2
                for values in (
                    result.displacement,
                    result.force,
                    result.moment,
                    *result.certificate.values(),
                ):
                    values[:] = np.nan
        return results

    return presser


def overflowing_presser(job, sensor, device):
    """Displacements of 4 mm and more do not fit into int16 steps of 0.1 um."""

    def presser(indenters, poses):
        results = fake_presser(job, sensor, device)(indenters, poses)
        results[0].displacement[...] = 4e-3
        return results

    return presser


RECORD = str(Path(tempfile.gettempdir()) / "simgen-pressers-{pid}")


def recorded_presser(job, sensor, device):
    """Writes down in which process it was made, and for which sensor."""
    with open(RECORD.format(pid=os.getpid()), "a") as file:
        file.write(f"{sensor} ")
    return fake_presser(job, sensor, device)


def forbidden_presser(job, sensor, device):
    raise PermissionError(13, "Permission denied", "/somewhere/else")


def raising_presser(job, sensor, device):
    """The second sensor's solver breaks down, while what the first one made is written."""

    def presser(indenters, poses):
        if sensor == "biotac":
            time.sleep(0.3)  # the first sensor's files are being written
            raise RuntimeError("no solver")
        return fake_presser(job, sensor, device)(indenters, poses)

    return presser


STUMBLED: list[int] = []


def stumbling_presser(job, sensor, device):
    """The third call raises, and no other."""

    def presser(indenters, poses):
        STUMBLED.append(len(STUMBLED))
        if len(STUMBLED) == 3:
            raise OSError(5, "Input/output error", "/somewhere/else")
        return fake_presser(job, sensor, device)(indenters, poses)

    return presser


POISON = 5  # a press


def poisoned_presser(job, sensor, device):
    """kill -9 of whichever process takes one of the presses."""
    pose = make_plan(job).arrays["press/contact_pose"][POISON]
    indenter = POISON % len(job.indenters)

    def presser(indenters, poses):
        if any(i == indenter and np.allclose(each, pose) for i, each in zip(indenters, poses, strict=True)):
            os.kill(os.getpid(), signal.SIGKILL)
        return fake_presser(job, sensor, device)(indenters, poses)

    return presser


def killed_presser(job, sensor, device):
    """kill -9 of this very process in the third task, half-way between the two sensors."""
    tasks = {"count": 0}

    def presser(indenters, poses):
        tasks["count"] += 1
        if sensor == "biotac" and tasks["count"] == 3:
            os.kill(os.getpid(), signal.SIGKILL)
        return fake_presser(job, sensor, device)(indenters, poses)

    return presser


LAST_WORDS = "SIMGEN_TEST_LAST_WORDS"  # environment variable: a file


def dying_presser(job, sensor, device):
    """kill -9 of the first process that makes one."""
    if not (died := Path(os.environ[LAST_WORDS])).exists():
        died.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return fake_presser(job, sensor, device)


def contents(path: Path) -> dict[str, bytes]:
    """Every byte of a dataset except the timings and the lock."""
    aside = ("timings.jsonl", ".lock")
    files = (file for file in sorted(path.rglob("*")) if file.is_file() and file.name not in aside)
    return {file.relative_to(path).as_posix(): file.read_bytes() for file in files}


def change(dataset: Dataset, name: str, index, value) -> None:
    """As if the run had written this: with checksums that fit."""
    zarr.open_group(dataset.path, mode="r+")[name][index] = value
    for manifest in (dataset.path / "manifest").glob("*.json"):
        text = json.loads(manifest.read_text())
        for file in text["sha256"]:
            text["sha256"][file] = hashlib.sha256((dataset.path / file).read_bytes()).hexdigest()
        manifest.write_text(json.dumps(text, indent=1))


def slow_presser(job, sensor, device):
    """0.2 s per press, so that there is time to interrupt, also on a machine with other work."""

    def presser(indenters, poses):
        time.sleep(0.2 * len(indenters))
        return fake_presser(job, sensor, device)(indenters, poses)

    return presser


def tiring_presser(job, sensor, device):
    """Its first shard takes a process no time, each other one a minute for each sensor."""
    shards = []

    def presser(indenters, poses):
        shards.append(len(indenters))
        if len(shards) > 1:
            time.sleep(60.0)
        return fake_presser(job, sensor, device)(indenters, poses)

    return presser
