"""HDF5 result files in the layouts of ACROSS and biotac_sim: reading and writing.

ACROSS (wzaielamri/across_framework), ``results_<sensor>_<job>.hdf5``; a trial is a contact, an env an indenter, a step
a depth::

    trial_<i>/step_<j>/nodal_coords_<sensor>/env_<k>      (vertex, 3) m, the deformed mesh
    trial_<i>/step_<j>/net_force_vecs_<sensor>/env_<k>    (3,) N, on the sensor
    trial_<i>/step_<j>/max_contact_distances/env_<k>      () m, depth of the press

biotac_sim (NVlabs/biotac_sim), one contact per file::

    step_<j>/nodal_coords/env_<k>, step_<j>/net_force_vecs/env_<k>

simgen adds attributes, which other readers ignore: to the file its origin, and to each ``env_<k>`` of the coordinates
the indenter's name and pose, the depth, and the sensor's pose.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from simgen.dataset.atomic_files import check_room
from simgen.dataset.hdf5_files import dataset_at, group_at, member_at, numbers, open_hdf5
from simgen.errors import InputError, system_errors

COORDINATES, FORCES, DISTANCES = "nodal_coords", "net_force_vecs", "max_contact_distances"
STATED = ("indenter", "pose", "depth_m", "sensor_pose")  # attributes of a sample that simgen wrote


@dataclass(frozen=True)
class Sample:
    """One press at one depth, in the frame of its file.

    The last four are None if the file does not state them.

    nodal_coordinates : (v, 3) m, of the deformed mesh
    force : (3,) N, on the sensor
    indenter : its name
    pose : (4, 4) m, indenter frame -> frame of the file, at this depth
    depth_m : depth from first touch
    sensor_pose : (4, 4) m, frame of the file -> shared frame of the sensors
    """

    trial: int
    env: int
    step: int
    nodal_coordinates: np.ndarray
    force: np.ndarray
    indenter: str | None = None
    pose: np.ndarray | None = None
    depth_m: float | None = None
    sensor_pose: np.ndarray | None = None


def write(path: Path, layout: str, sensor: str, samples: Iterable[Sample], about: Mapping[str, str | int]) -> None:
    """Write samples into one file, atomically; ``about`` becomes attributes of the file.

    Raises InputError for several trials in the layout biotac_sim, which has none.
    """
    partial = path.with_name(path.name + ".partial")
    trials = set()
    check_room(path.parent)
    with system_errors(), h5py.File(partial, "w") as file:
        file.attrs.update({"writer": "simgen", "sensor": sensor, **about})
        for sample in samples:
            check_room(path.parent)  # on a full disk HDF5 cannot even close its file
            trials.add(sample.trial)
            if layout == "biotac_sim" and len(trials) > 1:
                raise InputError(f"{path}: trials {sorted(trials)}; the layout biotac_sim holds one per file")
            _write_sample(file, layout, sensor, sample)
    os.replace(partial, path)


def _write_sample(file: h5py.File, layout: str, sensor: str, sample: Sample) -> None:
    step, suffix, env = f"step_{sample.step}", "", f"env_{sample.env}"
    if layout == "across":
        step, suffix = f"trial_{sample.trial}/{step}", f"_{sensor}"
        if sample.depth_m is not None:
            file[f"{step}/{DISTANCES}/{env}"] = sample.depth_m
    file[f"{step}/{COORDINATES}{suffix}/{env}"] = sample.nodal_coordinates.astype(np.float32)
    file[f"{step}/{FORCES}{suffix}/{env}"] = np.asarray(sample.force, dtype=np.float64)
    known = {key: getattr(sample, key) for key in STATED}
    attributes = file[f"{step}/{COORDINATES}{suffix}/{env}"].attrs
    attributes.update({key: value for key, value in known.items() if value is not None})


def is_result_file(path: Path) -> bool:
    """Check that a file is HDF5 with trials or steps at its root; recordings have the same suffix."""
    if not h5py.is_hdf5(path):
        return False
    with h5py.File(path) as file:
        return any(re.fullmatch(r"(trial|step)_\d+", key) for key in file)


class ResultFile:
    """A result file, open for reading; a context manager. Errors are InputError with file, key and what is expected.

    layout : ``across`` or ``biotac_sim``
    sensor : name in its groups or attributes; None in a file of biotac_sim
    attributes : of the file
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        self._file = open_hdf5(self.path)
        self.attributes = dict(self._file.attrs)
        self._trials = _numbered(self._file, "trial")
        steps = _numbered(self._file, "step")
        if not self._trials and not steps:
            self.close()
            raise InputError(f"{path}: neither trial_<i> (ACROSS) nor step_<j> (biotac_sim) at its root")
        self.layout = "across" if self._trials else "biotac_sim"
        self.sensor = self.attributes.get("sensor")
        if self.layout == "across":
            self.sensor = self.sensor or self._sensor_of_groups()

    def __enter__(self) -> ResultFile:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def close(self) -> None:
        self._file.close()

    def presses(self) -> dict[tuple[int, int], list[int]]:
        """Map (trial, env) to its steps, all rising; raises InputError if there are none."""
        found: dict[tuple[int, int], list[int]] = {}
        for trial in self._trials or [0]:
            steps = self._group(f"trial_{trial}" if self._trials else "/")
            for step in _numbered(steps, "step"):
                for env in _numbered(self._group(self._key(trial, step, COORDINATES)), "env"):
                    found.setdefault((trial, env), []).append(step)
        if not found:
            raise InputError(f"{self.path}: no env_<k> in any {COORDINATES}")
        return dict(sorted(found.items()))

    def sample(self, trial: int, env: int, step: int) -> Sample:
        """Read one sample."""
        coordinates = self._dataset(f"{self._key(trial, step, COORDINATES)}/env_{env}")
        force = self._dataset(f"{self._key(trial, step, FORCES)}/env_{env}")
        if coordinates.ndim != 2 or coordinates.shape[1] != 3:
            raise InputError(f"{self.path}: {coordinates.name}: shape {coordinates.shape}, expected (vertex, 3) in m")
        if force.shape != (3,):
            raise InputError(f"{self.path}: {force.name}: shape {force.shape}, expected (3,) in N")
        values = {"nodal_coordinates": numbers(self.path, coordinates), "force": numbers(self.path, force)}
        return Sample(trial, env, step, **values, **self.stated(trial, env, step))

    def stated(self, trial: int, env: int, step: int) -> dict[str, Any]:
        """Read the attributes of a sample that the file has: indenter, pose, depth_m, sensor_pose."""
        coordinates = self._dataset(f"{self._key(trial, step, COORDINATES)}/env_{env}")
        found = {key: coordinates.attrs[key] for key in STATED if key in coordinates.attrs}
        if not isinstance(name := found.get("indenter", ""), str):
            raise InputError(f"{self.path}: {coordinates.name}: attribute indenter: {name!r} is not a name")
        for key in found.keys() & {"pose", "sensor_pose"}:
            if (shape := np.shape(found[key])) != (4, 4):
                raise InputError(f"{self.path}: {coordinates.name}: attribute {key}: shape {shape}, expected (4, 4)")
        if "depth_m" not in found and self.layout == "across":
            distance = member_at(self.path, self._file, f"trial_{trial}/step_{step}/{DISTANCES}/env_{env}")
            if isinstance(distance, h5py.Dataset):
                found["depth_m"] = distance[...]
        if "depth_m" in found:
            depth = np.ravel(found["depth_m"])
            if depth.size != 1 or depth.dtype.kind not in "fiu" or not np.isfinite(depth).all():
                raise InputError(f"{self.path}: {coordinates.name}: {depth.tolist()} is not a depth in m")
            found["depth_m"] = float(depth[0])
        return found

    def __iter__(self) -> Iterator[Sample]:
        return (self.sample(*press, step) for press, steps in self.presses().items() for step in steps)

    def _key(self, trial: int, step: int, feature: str) -> str:
        if self.layout == "across":
            return f"trial_{trial}/step_{step}/{feature}_{self.sensor}"
        return f"step_{step}/{feature}"

    def _sensor_of_groups(self) -> str:
        trial = f"trial_{self._trials[0]}"
        for step in _numbered(self._group(trial), "step"):
            for name in self._group(f"{trial}/step_{step}"):
                if name.startswith(f"{COORDINATES}_"):
                    return name.removeprefix(f"{COORDINATES}_")
        raise InputError(f"{self.path}: {trial}: no step_<j>/{COORDINATES}_<sensor> in it")

    def _group(self, key: str) -> h5py.Group:
        return group_at(self.path, self._file, key)

    def _dataset(self, key: str) -> h5py.Dataset:
        return dataset_at(self.path, self._file, key)


def _numbered(group: h5py.Group, name: str) -> list[int]:
    """Numbers i of the members ``<name>_<i>`` of a group, rising."""
    found = (re.fullmatch(rf"{name}_(\d+)", key) for key in group)
    return sorted(int(match[1]) for match in found if match)
