"""Catalogue of result files, made before any array is read: samples, sensors, indenters, poses and depths."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from simgen.dataset.exchange.result_files import ResultFile
from simgen.dataset.exchange.selection import Track
from simgen.errors import InputError
from simgen.sensors.indenter import indenter_names
from simgen.sensors.indenter_pose import advanced


@dataclass(frozen=True)
class Place:
    """Location of a sample in its file. ``depth_m`` is None if the file does not state it."""

    path: Path
    trial: int
    env: int
    step: int
    depth_m: float | None


@dataclass
class Catalogue:
    """All samples of some files.

    samples : sensor -> (trial, indenter) -> its samples
    indenters : name -> its env
    first_touch : sensor -> (trial, indenter) -> pose (4, 4) m of the indenter at first touch, indenter frame -> shared
        frame of the sensors; only where the files state it
    sensor_pose : the same, sensor frame -> shared frame
    own_jobs : job of files that simgen wrote, as JSON -> a file with it; one job at most
    grown_from : numbers of trajectories of their dataset before each growth
    files : file -> its sensor and layout
    indenters_stated : False if names follow from the published order of environments
    """

    samples: dict[str, dict[tuple[int, str], list[Place]]] = field(default_factory=dict)
    indenters: dict[str, int] = field(default_factory=dict)
    first_touch: dict[str, dict[tuple[int, str], np.ndarray]] = field(default_factory=dict)
    sensor_pose: dict[str, dict[tuple[int, str], np.ndarray]] = field(default_factory=dict)
    own_jobs: dict[str, Path] = field(default_factory=dict)
    grown_from: tuple[int, ...] = ()
    files: dict[Path, dict[str, str]] = field(default_factory=dict)
    indenters_stated: bool = True

    @property
    def trials(self) -> list[int]:
        """Numbers of the trajectories, rising."""
        return sorted({trial for presses in self.samples.values() for trial, _ in presses})

    @property
    def names(self) -> list[str]:
        """Names of the indenters, in the order of their env."""
        return sorted(self.indenters, key=self.indenters.__getitem__)

    def depths(self) -> list[float | None]:
        """Depths of all samples, m."""
        return [place.depth_m for presses in self.samples.values() for places in presses.values() for place in places]


def read_catalogue(paths: Sequence[Path], meshes: Mapping[str, Path], track: Track) -> Catalogue:
    """List the samples of files; ``meshes`` maps sensors to their rest meshes.

    A file of biotac_sim is a trajectory. Its number is the attribute ``trial`` if simgen wrote it, else the number of
    earlier files of its sensor. Raises `InputError` for an unreadable file, a sensor without a mesh, a mesh without a
    file, and files of several jobs.
    """
    found = Catalogue({sensor: {} for sensor in meshes}, first_touch={sensor: {} for sensor in meshes},
                      sensor_pose={sensor: {} for sensor in meshes})  # fmt: skip
    for path in track(paths, "files"):
        with ResultFile(path) as file:
            sensor = _sensor_of(file, meshes)
            _add(found, file, sensor)
            found.files[path] = {"sensor": sensor, "layout": file.layout}
    for sensor, mesh in meshes.items():
        if not found.samples[sensor]:
            raise InputError(f"--mesh {sensor}={mesh}: no file of sensor {sensor!r} is given")
    return found


def _sensor_of(file: ResultFile, meshes: Mapping[str, Path]) -> str:
    """Sensor of a file; if the file does not name it, the only sensor with a mesh."""
    if file.sensor is None and len(meshes) == 1:
        return next(iter(meshes))
    if file.sensor is None:
        raise InputError(f"{file.path}: does not name its sensor; import it with one --mesh alone")
    if file.sensor not in meshes:
        raise InputError(f"{file.path}: sensor {file.sensor!r} has no --mesh; there are {', '.join(meshes)}")
    return file.sensor


def _add(found: Catalogue, file: ResultFile, sensor: str) -> None:
    if (job := file.attributes.get("job")) is not None:
        found.own_jobs.setdefault(str(job), file.path)
        if len(found.own_jobs) > 1:
            raise InputError(f"{file.path}: its job differs from that of {next(iter(found.own_jobs.values()))}; "
                             "import one job at a time")  # fmt: skip
        found.grown_from = _grown_from(file)
    presses, taken = found.samples[sensor], {trial for trial, _ in found.samples[sensor]}
    for (trial, env), steps in file.presses().items():
        stated = [file.stated(trial, env, step) for step in steps]
        number = trial
        if file.layout == "biotac_sim":
            number = _trajectory(found, file, sensor)
        if number in taken:
            raise InputError(f"{file.path}: trajectory {number} of {sensor} is in another file, too; "
                             "import one job at a time")  # fmt: skip
        name = _indenter(found, file, env, stated[0].get("indenter"))
        key = number, name
        if key in presses:
            raise InputError(f"{file.path}: trial {number}: env_{env} has the indenter of another env, {name}")
        presses[key] = [Place(file.path, trial, env, step, each.get("depth_m"))
                        for step, each in zip(steps, stated, strict=True)]  # fmt: skip
        if "sensor_pose" in stated[0]:
            found.sensor_pose[sensor][key] = stated[0]["sensor_pose"]
            if stated[0].keys() >= {"pose", "depth_m"}:
                pose = stated[0]["sensor_pose"] @ stated[0]["pose"]
                found.first_touch[sensor][key] = advanced(pose, -stated[0]["depth_m"])


def _grown_from(file: ResultFile) -> tuple[int, ...]:
    try:
        counts = json.loads(file.attributes.get("grown_from", "[]"))
        if all(isinstance(count, int) and count > 0 for count in counts) and counts == sorted(set(counts)):
            return tuple(counts)
    except (TypeError, ValueError):
        pass
    raise InputError(f"{file.path}: attribute grown_from: not what simgen wrote")


def _trajectory(found: Catalogue, file: ResultFile, sensor: str) -> int:
    """Number of the trajectory in a file of biotac_sim."""
    number = file.attributes.get("trial", sum(each["sensor"] == sensor for each in found.files.values()))
    if not isinstance(number, int | np.integer) or number < 0:
        raise InputError(f"{file.path}: attribute trial: {number!r} is not the number of a trajectory")
    return int(number)


def _indenter(found: Catalogue, file: ResultFile, env: int, name: str | None) -> str:
    """Name of an env's indenter, from the file or from the published order of environments."""
    if name is None:
        published = indenter_names()
        if env >= len(published):
            raise InputError(f"{file.path}: env_{env}: names no indenter, and the published order ends with "
                             f"env_{len(published) - 1}")  # fmt: skip
        name, found.indenters_stated = published[env], False
    found.indenters.setdefault(name, env)
    return name
