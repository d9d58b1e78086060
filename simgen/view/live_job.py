"""The job of a live press: one contact, one indenter and one path, from a user's choices; its file and its dataset.

A live press is a press of an ordinary job. So `simgen run` repeats it, and its dataset is like any other.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from simgen.config.choices import is_path
from simgen.config.job import job_from_dict, job_from_resolved, load_job
from simgen.config.job_schema import Job
from simgen.config.outputs import BY_COARSER_MESH
from simgen.errors import InputError, check_output_file, shown, writing
from simgen.pipeline.plan import make_plan
from simgen.pipeline.run import run

LIVE = "the press"  # names the job in messages
DEPTH_MM, DEPTHS = 1.0, 10  # without a job file


@dataclass(frozen=True)
class PressChoices:
    """Choices of a user for a press.

    contact : keys of `simgen.config.trajectories.GivenContact`
    indenter : name of one of the base job's indenters
    depth_mm, depths : the largest depth, and the number of evenly spaced depths
    mesh : simulation mesh of all sensors; None: those of the base job
    materials : by the job's name of a sensor, keys of `simgen.config.choices.MaterialChoice` that replace those of the
        base job
    """

    contact: Mapping[str, float]
    indenter: str
    depth_mm: float = DEPTH_MM
    depths: int = DEPTHS
    mesh: str | None = None
    materials: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


def base_job(
    sensors: Sequence[str], indenters: Sequence[str], unit: str = "m", outputs: Sequence[str] = (), mesh: str = "coarse"
) -> Job:
    """Make the job from which live presses start, without a job file.

    sensors : bundled models, or folders with a ``sensor.yaml``; the first is the one with the contacts
    indenters : bundled names, or closed meshes in the ``unit``
    outputs : optional outputs of all sensors

    Raises `InputError` for a value that a job does not allow.
    """
    chosen: dict[str, Any] = {}
    for model in sensors:
        name = Path(model).resolve().name if is_path(model) else model
        if name in chosen:
            raise InputError(f"sensor {shown(model)}: {name} is given twice; allowed: sensors with different names")
        chosen[name] = {"model": model, "mesh": mesh}
    data = {
        "name": "press",
        "sensors": chosen,
        "indenters": [{"file": file, "unit": unit} if is_path(file) else file for file in indenters],
        "trajectories": {"count": 1},
        "depths_mm": _depths(DEPTH_MM, DEPTHS),
        "outputs": {name: list(outputs) for name in chosen if outputs},
    }
    return _with_absolute_paths(job_from_dict(data, LIVE, folder=Path.cwd()))


def base_from_file(job: str | Path, overrides: Sequence[str] = ()) -> Job:
    """Read the job from which live presses start. Raises `InputError` as `simgen.config.job.load_job` does."""
    return _with_absolute_paths(load_job(job, overrides))


def live_job(base: Job, choices: PressChoices) -> Job:
    """Make the job of one press. Sensors, path, limits, outputs and solver are those of the base job.

    Displacements are stored in single precision. Estimates that need presses on a coarser mesh are left out. Raises
    `InputError` for a value that a job does not allow.
    """
    data = base.resolved()
    if choices.indenter not in base.indenter_names:
        allowed = ", ".join(base.indenter_names)
        raise InputError(f"{LIVE}: indenter {shown(repr(choices.indenter))} is not in the job; allowed: {allowed}")
    data["indenters"] = [data["indenters"][base.indenter_names.index(choices.indenter)]]
    data["trajectories"] |= {"count": 1, "contacts": [dict(choices.contact)]}
    depths = base.depths_mm
    if (choices.depth_mm, choices.depths) != (depths.last, depths.count):
        data["depths_mm"] = _depths(choices.depth_mm, choices.depths)
    for name, sensor in data["sensors"].items():
        sensor["mesh"] = choices.mesh or sensor["mesh"]
        sensor["material"] |= choices.materials.get(name, {})
    data["outputs"] = {
        name: [output for output in asked if output not in BY_COARSER_MESH]
        for name, asked in data.get("outputs", {}).items()
    }
    data["dataset"] |= {"displacement": "float32", "leave_out": None}
    return job_from_resolved(data, LIVE)


def write_job(job: Job, file: Path) -> None:
    """Write a job file that resolves to the same job in every folder. Raises `InputError` if it cannot be written."""
    check_output_file(file)
    data = job.model_dump(mode="json", exclude_defaults=True)
    data["trajectories"]["least_thickness_left"] = job.trajectories.least_thickness_left  # left out where it is 0
    text = yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=120)
    with writing(file):
        file.write_text(text, encoding="utf-8")


def save_dataset(job: Job, folder: Path, device: str = "cpu") -> None:
    """Solve a live press as `simgen run` does, into a dataset. This takes seconds.

    Raises `InputError` if the folder holds another dataset, or if it cannot be written.
    """
    failures = []
    run(make_plan(job, device), folder, on_report=lambda report: failures.append(report.error))
    if error := next(filter(None, failures), None):
        raise InputError(f"{folder}: {error}")


def _depths(last: float, count: int) -> dict[str, Any]:
    return {"first": round(last / max(count, 1), 6), "last": last, "count": count}  # to nanometres


def _with_absolute_paths(job: Job) -> Job:
    """The same job with absolute paths of sensors, output meshes and indenters."""
    data = job.resolved()
    for sensor in data["sensors"].values():
        sensor["model"] = _absolute(job, sensor["model"])
        if sensor.get("output"):
            file = job.folder / os.path.expanduser(sensor["output"]["file"])
            sensor["output"]["file"] = str(file.resolve())
    indenters = data["indenters"] = [{"file": each} if isinstance(each, str) else each for each in data["indenters"]]
    for indenter in indenters:
        indenter["file"] = _absolute(job, indenter["file"])
    return job_from_resolved(data, LIVE)


def _absolute(job: Job, text: str) -> str:
    return str(Path(job.locate(text)).resolve()) if is_path(text) else text
