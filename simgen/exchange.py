"""Result files of others: the HDF5 layouts of the ACROSS framework and of biotac_sim, written and read.

ACROSS (wzaielamri/across_framework), ``results_<sensor>_<job>.hdf5``; a trial is a contact, an env an indenter, a step
a depth::

    trial_<i>/step_<j>/nodal_coords_<sensor>/env_<k>      (vertex, 3) m, the deformed mesh
    trial_<i>/step_<j>/net_force_vecs_<sensor>/env_<k>    (3,) N, on the sensor
    trial_<i>/step_<j>/max_contact_distances/env_<k>      () m, depth of the press

biotac_sim (NVlabs/biotac_sim), one contact per file::

    step_<j>/nodal_coords/env_<k>, step_<j>/net_force_vecs/env_<k>

Files of simgen add attributes, which readers of these layouts do not look at: to the file what it came from, to each
``env_<k>`` of the coordinates the name of the indenter, its pose and the depth.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from simgen.dataset import Dataset
from simgen.errors import InputError

LAYOUTS = ("across", "biotac_sim")
COORDINATES, FORCES, DISTANCES = "nodal_coords", "net_force_vecs", "max_contact_distances"


@dataclass(frozen=True)
class Sample:
    """One press at one depth, in the frame of its file.

    nodal_coordinates : (v, 3) m, of the deformed mesh
    force : (3,) N, on the sensor
    indenter, pose, depth_m : name, indenter frame -> frame of the file (4, 4) in m at this depth, and depth from first
        touch in m; None where the file does not say
    """

    trial: int
    env: int
    step: int
    nodal_coordinates: np.ndarray
    force: np.ndarray
    indenter: str | None = None
    pose: np.ndarray | None = None
    depth_m: float | None = None


def export(dataset: Dataset, sensor: str, layout: str, folder: Path, trajectories: Iterable[int]) -> list[Path]:
    """Write trajectories of one sensor: one file in the ACROSS layout, one for each trajectory in biotac_sim's.

    Coordinates are in the sensor's own frame, in float32 as the published loaders read them; samples that did not
    converge are left out. Raises InputError for an unknown sensor or layout.
    """
    for key, value, allowed in (("sensor", sensor, dataset.sensors), ("layout", layout, LAYOUTS)):
        if value not in allowed:
            raise InputError(f"{key} {value!r}: allowed: {', '.join(allowed)}")
    about = {"job": json.dumps(dataset.attributes["job"]), "code": json.dumps(dataset.attributes.get("code"))}
    name, trajectories = f"results_{sensor}_{dataset.job.name}", list(trajectories)
    files = {f"{name}.hdf5": trajectories}
    if layout == "biotac_sim":
        files = {f"{name}_trial_{trajectory}.hdf5": [trajectory] for trajectory in trajectories}
    for file, chosen in files.items():
        write(folder / file, layout, sensor, dataset_samples(dataset, sensor, chosen), about)
    return [folder / file for file in files]


def dataset_samples(dataset: Dataset, sensor: str, trajectories: Iterable[int]) -> Iterator[Sample]:
    """The converged samples of some trajectories, in the frame of the sensor."""
    rest, depths = dataset[f"{sensor}/rest_positions"], dataset["depth"]
    trajectory, indenter = dataset["press/trajectory"], dataset["press/indenter"]
    status, force, touch = (dataset[f"{sensor}/{key}"] for key in ("status", "force", "touch"))
    first_touch = np.linalg.inv(dataset[f"{sensor}/pose"]) @ dataset["press/pose"]
    for press in np.flatnonzero(np.isin(trajectory, list(trajectories))):
        for step in np.flatnonzero(status[press] == 0):
            pose = first_touch[press].copy()
            pose[:3, 3] += (touch[press] + depths[step]) * pose[:3, 1]
            yield Sample(
                trial=int(trajectory[press]),
                env=int(indenter[press]),
                step=int(step),
                nodal_coordinates=rest + dataset.displacement(sensor, int(press), int(step)),
                force=force[press, step],
                indenter=dataset.indenters[indenter[press]],
                pose=pose,
                depth_m=float(depths[step]),
            )


def write(path: Path, layout: str, sensor: str, samples: Iterable[Sample], about: Mapping[str, str]) -> None:
    """Write samples into one file; ``about`` becomes attributes of the file. It appears whole or not at all.

    Raises InputError where biotac_sim's layout, which has no trials, is asked to hold several.
    """
    partial = path.with_name(path.name + ".partial")
    trials = set()
    with h5py.File(partial, "w") as file:
        file.attrs.update({"writer": "simgen", "sensor": sensor, **about})
        for sample in samples:
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
    known = {"indenter": sample.indenter, "pose": sample.pose, "depth_m": sample.depth_m}
    attributes = file[f"{step}/{COORDINATES}{suffix}/{env}"].attrs
    attributes.update({key: value for key, value in known.items() if value is not None})


def is_result_file(path: Path) -> bool:
    """Whether a file is HDF5 with trials or steps at its root; other recordings share the suffix."""
    if not h5py.is_hdf5(path):
        return False
    with h5py.File(path) as file:
        return any(re.fullmatch(r"(trial|step)_\d+", key) for key in file)


class ResultFile:
    """A result file in either layout, open for reading (a context manager).

    ``layout``; ``sensor``: the name in its groups or attributes, None in a file of biotac_sim; ``attributes`` of the
    file. Raises InputError, here and in `sample`, with file, key and what is expected there.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        try:
            self._file = h5py.File(self.path, "r")
        except OSError as error:
            raise InputError(f"{path}: cannot be read as HDF5 ({' '.join(str(error).split())})") from None
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
        """(trial, env) -> its steps, all in rising order; at least one."""
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
        coordinates = self._dataset(f"{self._key(trial, step, COORDINATES)}/env_{env}")
        force = self._dataset(f"{self._key(trial, step, FORCES)}/env_{env}")
        if coordinates.ndim != 2 or coordinates.shape[1] != 3:
            raise InputError(f"{self.path}: {coordinates.name}: shape {coordinates.shape}, expected (vertex, 3) in m")
        if force.shape != (3,):
            raise InputError(f"{self.path}: {force.name}: shape {force.shape}, expected (3,) in N")
        values = {"nodal_coordinates": coordinates[...].astype(float), "force": force[...].astype(float)}
        for key, array in zip((coordinates.name, force.name), values.values(), strict=True):
            if not np.isfinite(array).all():
                raise InputError(f"{self.path}: {key}: values that are not finite numbers")
        attributes = coordinates.attrs
        pose = attributes.get("pose")
        if pose is not None and pose.shape != (4, 4):
            raise InputError(f"{self.path}: {coordinates.name}: attribute pose: shape {pose.shape}, expected (4, 4)")
        depth = attributes.get("depth_m")
        return Sample(trial, env, step, **values, indenter=attributes.get("indenter"), pose=pose,
                      depth_m=None if depth is None else float(depth))  # fmt: skip

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
        if not isinstance(found := self._file.get(key), h5py.Group):
            raise InputError(f"{self.path}: {key}: not there, expected a group")
        return found

    def _dataset(self, key: str) -> h5py.Dataset:
        if not isinstance(found := self._file.get(key), h5py.Dataset):
            raise InputError(f"{self.path}: {key}: not there, expected numbers")
        return found


def _numbered(group: h5py.Group, name: str) -> list[int]:
    """The numbers i of the members ``<name>_<i>`` of a group, rising."""
    found = (re.fullmatch(rf"{name}_(\d+)", key) for key in group)
    return sorted(int(match[1]) for match in found if match)
