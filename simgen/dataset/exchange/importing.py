"""Import of result files of ACROSS and biotac_sim as a dataset.

Displacements are coordinates minus the rest positions of a mesh that the user gives. Values that the files lack are not
made up: numbers are NaN or -1; arrays of the plan (``held``, ``touchable``, ``press/contact_pose``) and keys of the job
are left out. The attribute ``source`` names the files. ``<sensor>/stated_depth`` (press, depth) holds the depths of the
files, m; the dataset's own depths are evenly spaced.
"""

import json
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from simgen.config.job import job_from_dict, job_from_resolved
from simgen.config.job_schema import Job, hash_of
from simgen.dataset import provenance
from simgen.dataset.atomic_files import check_new, put_in_place, whole_folder
from simgen.dataset.exchange.catalogue import Catalogue, Place, read_catalogue
from simgen.dataset.exchange.depths import depth_axis, on_axis
from simgen.dataset.exchange.rest_meshes import RestMesh, read_rest_meshes
from simgen.dataset.exchange.result_files import ResultFile, Sample
from simgen.dataset.exchange.selection import Track, untracked
from simgen.dataset.provenance import file_hash
from simgen.dataset.reader import Dataset
from simgen.dataset.splits import SPLITS, leave_out, split_by_trajectory
from simgen.dataset.stored_arrays import path_arrays
from simgen.dataset.writer import manifest_aside, write_aside, write_plan
from simgen.errors import InputError, writing
from simgen.units import MM_PER_M

ABSENT = 100  # status of a sample that no file holds
STATUS = {"0": "In a file that was imported.", str(ABSENT): "In none of the files that were imported."}
FARTHEST_MM = 10.0  # largest displacement of a vertex; no press is deeper


def import_results(
    files: Sequence[Path],
    meshes: Sequence[str],
    output: Path,
    name: str | None = None,
    depths_mm: str | None = None,
    origins_mm: Sequence[str] = (),
    track: Track = untracked,
) -> Dataset:
    """Make a dataset from result files, atomically.

    meshes : ``SENSOR=FILE`` for each sensor, its rest mesh of tetrahedra, m
    name : name of the job; by default the name of the files' job, if simgen wrote them, else that of the output
    depths_mm : ``first:last:count`` if the files state no depths or uneven ones; each sample goes to the nearest depth
    origins_mm : ``SENSOR=X,Y,Z``, origin of the mesh in the coordinates of the files, by default 0,0,0; biotac_sim has
        0,50,0

    Raises `InputError` for files that cannot be read or do not fit together, and if the output cannot be written.
    """
    check_new(output)
    rest = read_rest_meshes(meshes, origins_mm)
    found = read_catalogue(files, {sensor: mesh.path for sensor, mesh in rest.items()}, track)
    own = _own_job(found)
    axis = depth_axis(found, depths_mm, own)
    legs = own.resolved()["trajectories"].get("path", []) if own else []
    if legs and depths_mm is not None:
        raise InputError("--depths-mm: the files' job has legs, whose steps are kept as they are; leave it out")
    job = _job(found, rest, axis, legs, own, name or (own.name if own else output.name.removesuffix(".zarr")))
    samples, left_out = on_axis(found, job.indenter_path)
    attributes = _attributes(found, rest, job, left_out)
    with writing(output), whole_folder(output.resolve()) as folder:
        write_plan(folder, attributes, _planned(found, rest, job, own, samples), job)
        _fill(Dataset(folder), found, rest, samples, track)
    return Dataset(output)


def _own_job(found: Catalogue) -> Job | None:
    """Job of files that simgen wrote."""
    for text, path in found.own_jobs.items():
        try:
            return job_from_resolved(json.loads(text), f"{path}: job")
        except (TypeError, json.JSONDecodeError):
            raise InputError(f"{path}: attribute job: not what simgen wrote") from None
    return None


def _job(
    found: Catalogue, rest: Mapping[str, RestMesh], axis: dict, legs: list[dict], own: Job | None, name: str
) -> Job:
    """Make a job from what the files state; its other keys have defaults that mean nothing."""
    return job_from_dict(
        {
            "name": name,
            "seed": own.seed if own else 0,
            "sensors": {sensor: {"model": mesh.path.name} for sensor, mesh in rest.items()},
            "indenters": found.names,
            "trajectories": {"count": len(found.trials), **({"path": legs} if legs else {})},
            "depths_mm": axis,
            "dataset": {"displacement": "float32"},
        },
        "what is imported",
        {"name": "--name", "depths_mm": "depths"},
    )


def _attributes(found: Catalogue, rest: Mapping[str, RestMesh], job: Job, left_out: int) -> dict:
    stated = job.model_dump(mode="json", exclude_unset=True)
    job_of_files = [json.loads(text) for text in found.own_jobs]
    return {
        "job": stated,
        "job_hash": hash_of(stated),
        "code": provenance.code_version(),
        "packages": provenance.package_versions(),
        "splits": list(SPLITS),
        "status": STATUS,
        "source": {
            "files": [{"name": path.name, **about, "sha256": file_hash(path)} for path, about in found.files.items()],
            "meshes": {
                sensor: {
                    "name": mesh.path.name,
                    "sha256": file_hash(mesh.path),
                    "origin_mm": (MM_PER_M * mesh.origin).tolist(),
                    "rounding_m": mesh.rounding,
                }
                for sensor, mesh in rest.items()
            },
            "job": job_of_files[0] if job_of_files else None,
            "indenters": "named in the files" if found.indenters_stated else "the published order of environments",
            "samples_left_out": left_out,
            "not_stated": "contacts, materials, solver, moments and certificates; poses and depths that are NaN",
        },
    }


def _planned(
    found: Catalogue, rest: Mapping[str, RestMesh], job: Job, own: Job | None, samples: Mapping
) -> dict[str, np.ndarray]:
    trials, keys = np.array(found.trials, np.int32), _keys(found)
    of_press = np.repeat(np.arange(len(trials)), len(found.names))
    indenter = np.tile(np.arange(len(found.names), dtype=np.int32), len(trials))
    arrays = {
        **path_arrays(job.indenter_path),
        "press/trajectory": trials[of_press],
        "press/indenter": indenter,
        "press/split": _splits(trials, of_press, indenter, job, own, found.grown_from),
    }
    for sensor, mesh in rest.items():
        depth = np.full((len(keys), len(job.depths_m)), np.nan)
        for press, key in enumerate(keys):
            for index, place in samples[sensor].get(key, {}).items():
                depth[press, index] = np.nan if place.depth_m is None else place.depth_m
        nowhere = np.full((4, 4), np.nan)
        arrays |= {f"{sensor}/{key}": values for key, values in mesh.arrays.items()}
        arrays[f"{sensor}/stated_depth"] = depth
        pose = np.stack([found.sensor_pose[sensor].get(key, nowhere) for key in keys])
        pose[:, :3, 3] += pose[:, :3, :3] @ mesh.origin
        arrays[f"{sensor}/pose"] = pose
    return arrays


def _splits(
    trials: np.ndarray, of_press: np.ndarray, indenter: np.ndarray, job: Job, own: Job | None, grown_from: Sequence[int]
) -> np.ndarray:
    """Splits (press,) int8. Presses of a job of simgen keep their splits, so that training data stay training data."""
    if own is None or trials[-1] >= own.trajectories.count:
        return split_by_trajectory(len(trials), job.seed)[of_press]
    split = split_by_trajectory(own.trajectories.count, own.seed, grown_from)[trials[of_press]]
    if (name := own.dataset.leave_out) is None:
        return split
    left_out = job.indenter_names.index(name) if name in job.indenter_names else len(job.indenter_names)
    return leave_out(split, indenter, left_out)


def _keys(found: Catalogue) -> list[tuple[int, str]]:
    """Trial and indenter of each press."""
    return [(trial, name) for trial in found.trials for name in found.names]


def _fill(
    dataset: Dataset, found: Catalogue, rest: Mapping[str, RestMesh], samples: Mapping, track: Track
) -> None:
    """Write the shards; arrays of one sensor are in memory at a time."""
    keys = _keys(found)
    with TemporaryDirectory(dir=dataset.path) as staging, closing(_Reader(dataset, rest)) as reader:
        for shard in track(range(dataset.shards), "shards"):
            of_shard = [keys[press] for press in dataset.shard_presses(shard)]
            poses = [_reference(found, key) for key in of_shard]
            files = write_aside(dataset, shard, {"press/pose": poses}, Path(staging))
            for sensor in dataset.sensors:
                columns = reader.read(sensor, [samples[sensor].get(key, {}) for key in of_shard])
                touched = [found.first_touch[sensor].get(key) for key in of_shard]
                columns[f"{sensor}/touch"] = list(map(_travel, poses, touched))
                files |= write_aside(dataset, shard, columns, Path(staging))
            manifest = manifest_aside(shard, files, Path(staging))
            put_in_place(dataset.path, files)
            put_in_place(dataset.path, manifest)


def _reference(found: Catalogue, key: tuple[int, str]) -> np.ndarray:
    """``press/pose``: the indenter's pose at first touch of the first sensor with a known one; else NaN."""
    known = (found.first_touch[sensor][key] for sensor in found.samples if key in found.first_touch[sensor])
    return next(known, np.full((4, 4), np.nan))


def _travel(pose: np.ndarray, touched: np.ndarray | None) -> float:
    return np.nan if touched is None else float((touched - pose)[:3, 3] @ pose[:3, 1])


class _Reader:
    """Reads presses of files; the last file of each sensor stays open."""

    def __init__(self, dataset: Dataset, rest: Mapping[str, RestMesh]):
        self.dataset, self._files = dataset, {}
        self.rest = {sensor: mesh.in_files for sensor, mesh in rest.items()}

    def close(self) -> None:
        for file in self._files.values():
            file.close()

    def read(self, sensor: str, presses: Sequence[Mapping[int, Place]]) -> dict[str, list[np.ndarray]]:
        """Read arrays of a sensor, by path, for presses that map depths to places; NaN at other depths."""
        columns = {name: [np.full(array.shape, np.nan, "float32" if array.chunk else float) for _ in presses]
                   for name, array in self.dataset.arrays.items() if name.startswith(f"{sensor}/")}  # fmt: skip
        for row, places in enumerate(presses):
            columns[f"{sensor}/status"][row][:] = ABSENT
            for depth, place in places.items():
                sample = self._open(sensor, place.path).sample(place.trial, place.env, place.step)
                columns[f"{sensor}/status"][row][depth] = 0
                columns[f"{sensor}/force"][row][depth] = sample.force
                columns[f"{sensor}/displacement"][row][depth] = self._displacement(sensor, place, sample)
        return columns

    def _displacement(self, sensor: str, place: Place, sample: Sample) -> np.ndarray:
        rest, where = self.rest[sensor], f"{place.path}: trial {place.trial}, env {place.env}, step {place.step}"
        if len(sample.nodal_coordinates) != len(rest):
            vertices = len(sample.nodal_coordinates)
            raise InputError(f"{where}: {vertices} vertices, but the mesh of {sensor} has {len(rest)}")
        moved = sample.nodal_coordinates - rest
        if (farthest_mm := MM_PER_M * np.linalg.norm(moved, axis=1).max()) > FARTHEST_MM:
            raise InputError(
                f"{where}: a vertex is {farthest_mm:.3g} mm from the mesh of {sensor}, at most {FARTHEST_MM:g} "
                "is allowed; the mesh must be at rest, in m, its vertices in the same order, its origin at --origin-mm"
            )
        return moved

    def _open(self, sensor: str, path: Path) -> ResultFile:
        last = self._files.get(sensor)
        if last is None or last.path != path:
            if last is not None:
                last.close()
            self._files[sensor] = ResultFile(path)
        return self._files[sensor]
