"""Stand-ins that make a whole dataset in a second: a plan on two tetrahedra, a press by formula."""

import os
import signal
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from simgen.dataset import split_by_trajectory
from simgen.job import Job, job_from_dict

VERTICES = np.array([[0, 0, 0], [2, 0, 0], [0, 0, 2], [0, -2, 0], [2, -2, 2]]) * 1e-3
TETRAHEDRA = np.array([[0, 1, 2, 3], [1, 2, 3, 4]], np.int32)
SURFACE = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 4, 2], [1, 3, 4], [2, 4, 3]], np.int32)


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
    """As `simgen.plan.make_plan`: attributes and arrays, contacts near the middle of one free triangle."""
    count, indenters = job.trajectories.count, len(job.indenters)
    trajectory = np.repeat(np.arange(count, dtype=np.int32), indenters)
    triangle = VERTICES[SURFACE[4]]
    normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
    normal /= np.linalg.norm(normal)
    side = np.cross(normal, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    weights = np.random.default_rng(job.seed).dirichlet([5, 5, 5], count)
    contact = np.tile(np.eye(4), (count, 1, 1))
    contact[:, :3, :3] = np.stack([side, -normal, np.cross(side, -normal)], axis=1)
    contact[:, :3, 3] = weights @ triangle
    arrays = {
        "depth": job.depths_m,
        "press/trajectory": trajectory,
        "press/indenter": np.tile(np.arange(indenters, dtype=np.int32), count),
        "press/split": split_by_trajectory(count, job.seed)[trajectory],
        "press/contact_pose": contact[trajectory],
        "press/contact_normal": np.tile(normal, (len(trajectory), 1)),
    }
    for sensor in job.sensors:
        arrays |= {
            f"{sensor}/rest_positions": VERTICES,
            f"{sensor}/tetrahedra": TETRAHEDRA,
            f"{sensor}/surface_triangles": SURFACE,
            f"{sensor}/held": np.array([True, True, True, False, False]),
            f"{sensor}/touchable": np.array([False, True, False, True, True]),
            f"{sensor}/pose": np.tile(np.eye(4), (len(trajectory), 1, 1)),
        }
    attributes = {"job": job.resolved(), "job_hash": job.hash, "status": {"0": "Converged.", "1": "Stalled."}}
    return SimpleNamespace(job=job, device="cpu", attributes=attributes, arrays=arrays)


def fake_result(indenter: int, pose: np.ndarray, depths: np.ndarray, seconds: float) -> SimpleNamespace:
    """A `PressResult`: displacement grows with depth and depends on the pose, so every press differs."""
    direction = np.zeros((len(VERTICES), 3))
    direction[3:] = pose[:3, 1] + pose[:3, 3] * 100 + 0.1 * indenter
    ones = np.ones(len(depths))
    certificate = {
        "residual": 1e-6 * ones,
        "contact_error": 1e-4 * ones,
        "force_balance": 1e-6 * ones,
        "min_det_F": 0.9 * ones,
        "rms_penetration_m": 1e-6 * ones,
        "max_penetration_m": 3e-6 * ones,
        "newton_iterations": 4 * ones,
        "krylov_iterations": 40 * ones,
        "substeps": ones,
    }
    return SimpleNamespace(
        displacement=depths[:, None, None] * direction,
        force=depths[:, None] * 1e3 * pose[:3, 1],
        moment=depths[:, None] * pose[:3, 3],
        status=np.zeros(len(depths), np.int8),
        certificate=certificate,
        touch=1e-5 * (indenter + 1),
        seconds=seconds,
    )


def fake_presser(job, sensor, device):
    def presser(indenters, poses, depths):
        return [fake_result(i, pose, depths, 0.01) for i, pose in zip(indenters, poses, strict=True)]

    return presser


def failing_presser(job, sensor, device):
    """The ring stalls from the third depth on."""

    def presser(indenters, poses, depths):
        results = fake_presser(job, sensor, device)(indenters, poses, depths)
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


def overflowing_presser(job, sensor, device):
    """Displacements of 4 mm and more do not fit into int16 steps of 0.1 um."""

    def presser(indenters, poses, depths):
        results = fake_presser(job, sensor, device)(indenters, poses, depths)
        results[0].displacement[...] = 4e-3
        return results

    return presser


def killed_presser(job, sensor, device):
    """kill -9 of this very process in the third task, half-way between the two sensors."""
    tasks = {"count": 0}

    def presser(indenters, poses, depths):
        tasks["count"] += 1
        if sensor == "biotac" and tasks["count"] == 3:
            os.kill(os.getpid(), signal.SIGKILL)
        return fake_presser(job, sensor, device)(indenters, poses, depths)

    return presser


def contents(path: Path) -> dict[str, bytes]:
    """Every byte of a dataset except the timings."""
    files = (file for file in sorted(path.rglob("*")) if file.is_file() and file.name != "timings.jsonl")
    return {file.relative_to(path).as_posix(): file.read_bytes() for file in files}
