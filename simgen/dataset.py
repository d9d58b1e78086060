"""The dataset: its layout, the writer of shards, and the reader.

One zarr v3 directory, in SI units::

    <name>.zarr/
      attributes                                       resolved job and hash, code, packages, meshes, status
      depth (depth,)                                   m, from true first touch
      press/trajectory, indenter (press,)              the contact; index into the job's indenters
      press/split (press,)                             0 train, 1 validation, 2 test: by trajectory
      press/contact_pose (press, 4, 4)                 indenter -> shared frame, its tip at the contact point
      press/contact_normal (press, 3)                  outward, of the reference sensor, in the shared frame
      press/pose (press, 4, 4)                         contact_pose moved along its +y to first touch on the
                                                       reference sensor, or contact_pose if never touched
      <sensor>/rest_positions (vertex, 3)              the output mesh in the sensor's own frame
      <sensor>/tetrahedra, surface_triangles, held, touchable
      <sensor>/pose (press, 4, 4)                      sensor -> shared frame: the unfolding transform
      <sensor>/touch (press,)                          travel from press/pose to first touch on this sensor;
                                                       NaN if never touched
      <sensor>/displacement (press, depth, vertex, 3)  int16 in steps of 1e-7 m, or float32 in m
      <sensor>/force, moment (press, depth, 3)         N, N m: on the sensor, in its frame, with friction
      <sensor>/cavity_pressure (press, depth)          Pa above ambient; only with a fluid in its cavity
      <sensor>/status (press, depth)                   0 converged; the sentences are in the attributes
      <sensor>/certificate/* (press, depth)            residual, force_balance, min_det_F, ...
      manifest/*.json                                  sha256 of every file: the plan's, each finished shard's
      manifest/timings.jsonl                           when, where, how long: all that the job does not decide

A shard is what one task writes: the same presses of every array, one file per array. Two writers never share
one. Each file is written aside, flushed to disk and renamed, the manifests last: a shard without one does not
exist, so a run that is killed at any moment goes on from there. A sample that was not reached holds the fill
value (NaN, -1, or -32768 in int16) and its status.
"""

import hashlib
import json
import os
import shutil
import tempfile
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from zarr.codecs import BloscCodec

from simgen import whole_files
from simgen.chunk_files import COMPRESSION, chunk_file, open_sharded, sharded_files
from simgen.errors import InputError
from simgen.job import Job, job_from_dict
from simgen.provenance import difference
from simgen.whole_files import Aside, put_in_place

SCHEMA = 1
DISPLACEMENT_STEP_M = 1e-7
NOT_REACHED = np.iinfo(np.int16).min  # of int16 displacement; -1 of the integers, NaN of the floats
SPLITS = {"train": 0.79, "validation": 0.10, "test": 0.11}
PLAN = "plan"
STAGING = ".staging"
TIMINGS = "timings.jsonl"

CERTIFICATE = {
    "residual": ("float64", "out-of-balance forces over contact forces, Euclidean norms over the nodes"),
    "contact_error": ("float64", "relative change (L2, weighted by edges) that one more multiplier update would make"),
    "force_balance": ("float64", "|contact force + reaction of what is held| / |contact force|"),
    "min_det_F": ("float64", "least det F over the elements' quadrature points"),
    "inverted_elements": ("int32", "elements with det F <= 0 at corners, thirds of edges or middles of faces"),
    "rms_penetration_m": ("float64", "root mean square pointwise penetration over the contact area, m"),
    "max_penetration_m": ("float64", "largest pointwise penetration, m"),
    "newton_iterations": ("int32", "Newton iterations of this depth, all sub-steps"),
    "krylov_iterations": ("int32", "iterations of the linear solver of this depth"),
    "substeps": ("int32", "load increments attempted from the depth before, failed ones included"),
}
LIQUID_CERTIFICATE = {"liquid_volume_error": ("float64", "change of the liquid's volume / volume of the cavity")}


@dataclass(frozen=True)
class Array:
    """One array that tasks write: its shape behind the press axis, and how it is stored."""

    shape: tuple[int, ...]
    dtype: str
    about: str
    unit: str = ""
    chunk: tuple[int, ...] | None = None  # one read of training; by default all of the press
    attributes: dict[str, float] = field(default_factory=dict)

    @property
    def fill(self) -> float | int:
        return {"float32": np.nan, "float64": np.nan, "int16": NOT_REACHED}.get(self.dtype, -1)


def written_arrays(job: Job, output_vertices: Mapping[str, int]) -> dict[str, Array]:
    """What the tasks write, by path; `output_vertices` gives their number on each sensor."""
    depths, displacement = len(job.depths_m), job.dataset.displacement
    about = "indenter to shared frame at first touch, or the contact pose where there is none"
    arrays = {"press/pose": Array((4, 4), "float64", about, "m")}
    for sensor, vertices in output_vertices.items():
        scale = {"scale_factor": DISPLACEMENT_STEP_M} if displacement == "int16" else {}
        arrays |= {
            f"{sensor}/touch": Array((), "float64", "travel from press/pose to first touch, NaN if none", "m"),
            f"{sensor}/displacement": Array(
                (depths, vertices, 3), displacement, "of output vertices", "m", (1, vertices, 3), scale
            ),
            f"{sensor}/force": Array((depths, 3), "float64", "on the sensor, in its frame", "N"),
            f"{sensor}/moment": Array((depths, 3), "float64", "about the origin of the sensor frame", "N m"),
            f"{sensor}/status": Array((depths,), "int8", "0 converged; names in the root attributes"),
        }
        certificate = CERTIFICATE
        if job.sensors[sensor].fluid != "none":
            about = "of the liquid in the cavity, above ambient"
            arrays[f"{sensor}/cavity_pressure"] = Array((depths,), "float64", about, "Pa")
            certificate = CERTIFICATE | LIQUID_CERTIFICATE
        for key, (dtype, about) in certificate.items():
            arrays[f"{sensor}/certificate/{key}"] = Array((depths,), dtype, about)
    return arrays


def split_by_trajectory(count: int, seed: int) -> np.ndarray:
    """(count,) int8 split of each trajectory: seeded, 79 / 10 / 11 % to the nearest trajectory."""
    order = np.random.default_rng([seed, 79, 10, 11]).permutation(count)
    bounds = np.rint(np.cumsum(list(SPLITS.values()))[:-1] * count).astype(int)
    split = np.empty(count, np.int8)
    for code, members in enumerate(np.split(order, bounds)):
        split[members] = code
    return split


def create(path: Path, attributes: Mapping[str, Any], planned: Mapping[str, np.ndarray], job: Job) -> None:
    """Make the folder with all that is known before the first press. It appears whole or not at all.

    `planned` maps a path such as ``press/trajectory`` or ``digit/rest_positions`` to its array.
    """
    staging = path.with_name(f"{path.name}.partial")
    shutil.rmtree(staging, ignore_errors=True)
    root = zarr.create_group(staging, attributes={"schema": SCHEMA, **attributes})
    for name, values in planned.items():
        root.create_array(name, data=np.asarray(values))
    vertices = {sensor: len(planned[f"{sensor}/rest_positions"]) for sensor in job.sensors}
    arrays = written_arrays(job, vertices)
    for name, array in arrays.items():
        _create_written(root, name, array, job.presses, job.dataset.presses_per_shard)
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore"
        )  # consolidated metadata are zarr-python's own, and worth having: one read
        zarr.consolidate_metadata(staging)
    sums = {
        file.relative_to(staging).as_posix(): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in staging.rglob("*")
        if file.is_file()
    }
    put_in_place(staging, {f"manifest/{PLAN}.json": whole_files.write_aside(staging, _manifest(sums))})
    os.replace(staging, path)


def _create_written(root: zarr.Group, name: str, array: Array, presses: int, per_shard: int) -> None:
    shard = (per_shard, *array.shape)
    root.create_array(
        name,
        shape=(presses, *array.shape),
        dtype=array.dtype,
        chunks=(1, *array.chunk) if array.chunk else shard,
        shards=shard if array.chunk else None,
        compressors=BloscCodec(shuffle="shuffle", **COMPRESSION),
        fill_value=array.fill,
        attributes={"about": array.about, **({"unit": array.unit} if array.unit else {}), **array.attributes},
    )


class Dataset:
    """A dataset on disk, open for reading.

    ``dataset.displacement("biotac", press, depth)`` is (vertex, 3) in m, NaN where the press did not get to;
    ``dataset["biotac/force"]`` is any array, read whole; ``dataset.root`` is the zarr group itself.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        if not (self.path / "zarr.json").is_file():
            raise InputError(f"{path}: not a dataset (a folder that `simgen run` wrote, with a zarr.json)")
        self.root = zarr.open_group(self.path, mode="r")
        self._open: dict[str, zarr.Array] = {}  # the sharded ones
        self.attributes = dict(self.root.attrs)
        if self.attributes.get("schema") != SCHEMA:
            raise InputError(f"{path}: schema {self.attributes.get('schema')}; this version reads {SCHEMA}")

    def __getitem__(self, name: str) -> np.ndarray:
        return self.root[name][...]

    @cached_property
    def job(self) -> Job:
        return job_from_dict(self.attributes["job"], source=f"{self.path}: job")

    @cached_property
    def sensors(self) -> tuple[str, ...]:
        return tuple(self.job.sensors)

    @cached_property
    def indenters(self) -> tuple[str, ...]:
        return self.job.indenter_names

    @property
    def presses(self) -> int:
        return self.job.presses

    @property
    def shards(self) -> int:
        return self.job.shards

    @cached_property
    def arrays(self) -> dict[str, Array]:
        """What tasks write, by path, as this dataset should have it."""
        vertices = {sensor: self.root[f"{sensor}/rest_positions"].shape[0] for sensor in self.sensors}
        return written_arrays(self.job, vertices)

    def shard_presses(self, shard: int) -> range:
        per_shard = self.job.dataset.presses_per_shard
        return range(shard * per_shard, min((shard + 1) * per_shard, self.presses))

    def finished(self) -> list[int]:
        """Shards that are whole, by their manifests."""
        return sorted(int(file.stem) for file in (self.path / "manifest").glob("[0-9]*.json"))

    def unfinished(self) -> list[int]:
        return sorted(set(range(self.shards)) - set(self.finished()))

    def displacement(self, sensor: str, press: int | slice, depth: int | slice = slice(None)) -> np.ndarray:
        """(..., vertex, 3) float64 in m; NaN where not reached or not there yet."""
        array = self._sharded(f"{sensor}/displacement")
        stored = array[press, depth]
        scale = array.attrs.get("scale_factor")
        return (
            stored.astype(np.float64)
            if scale is None
            else np.where(stored == NOT_REACHED, np.nan, stored * scale)
        )

    def _sharded(self, name: str) -> zarr.Array:
        if name not in self._open:
            self._open[name] = open_sharded(self.path, name)
        return self._open[name]

    def checksums(self) -> dict[str, str]:
        """sha256 of every file that a manifest vouches for, by its path in the dataset."""
        sums = {}
        for file in sorted((self.path / "manifest").glob("*.json")):
            sums |= json.loads(file.read_text())["sha256"]
        return sums


def open_or_create(
    path: Path, attributes: Mapping[str, Any], planned: Mapping[str, np.ndarray], job: Job
) -> Dataset:
    """The dataset of exactly this plan: made anew, or found on disk from an earlier, unfinished run.

    Raises `InputError` with the difference if what lies there came from another job, code or mesh.
    """
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        create(path, attributes, planned, job)
        return Dataset(path)
    dataset = Dataset(path)
    asked = json.loads(json.dumps({"schema": SCHEMA, **attributes}))
    if dataset.attributes != asked or dataset.attributes["job_hash"] != asked["job_hash"]:
        changes = difference(dataset.attributes, asked)
        shown = (
            "; ".join(change for change in changes if not change.startswith("job_hash")) or "order of sensors"
        )
        raise InputError(f"{path}: holds another dataset ({shown}); remove it or choose another --output")
    shutil.rmtree(path / STAGING, ignore_errors=True)
    return dataset


@contextmanager
def folder_aside(dataset: Dataset) -> Iterator[Path]:
    """A folder for what a task has not put in its place yet; whatever is left there is removed with it."""
    staging = dataset.path / STAGING
    staging.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(dir=staging) as folder:
        yield Path(folder)


def write_aside(
    dataset: Dataset, shard: int, values: Mapping[str, Sequence[np.ndarray]], folder: Path
) -> dict[str, Aside]:
    """Files of some of a shard's arrays by path, on the disk but not in their places yet.

    `values`, by path too, are float arrays in SI, one for each press. Raises `OverflowError` if a displacement does not
    fit the stored type.
    """
    presses, files = dataset.shard_presses(shard), {}
    for name, of_presses in values.items():
        array = dataset.arrays[name]
        if array.chunk:  # a press at a time: what is double for a moment stays small
            stored = np.stack([_encode(np.asarray(value), array, name) for value in of_presses])
            made = sharded_files(dataset.path, name, presses, stored, folder)
        else:
            stored = _encode(np.stack(of_presses), array, name)
            made = chunk_file(name, shard, stored, dataset.job.dataset.presses_per_shard, array.fill)
        files |= {path: whole_files.write_aside(folder, data) for path, data in made.items()}
    return files


def manifest_aside(shard: int, files: Mapping[str, Aside], folder: Path) -> dict[str, Aside]:
    """The manifest of a shard, by path, which says that these are its files."""
    text = _manifest({path: file.sha256 for path, file in files.items()}, shard=shard)
    return {f"manifest/{shard:06d}.json": whole_files.write_aside(folder, text)}


def finish(dataset: Dataset) -> None:
    """Remove what a killed run may have left aside."""
    shutil.rmtree(dataset.path / STAGING, ignore_errors=True)


def log_timing(dataset: Dataset, entry: Mapping[str, Any]) -> None:
    with open(dataset.path / "manifest" / TIMINGS, "a", encoding="utf-8") as file:
        file.write(json.dumps(entry) + "\n")


def _encode(values: np.ndarray, array: Array, name: str) -> np.ndarray:
    """Floats to the stored type; NaN becomes the fill value."""
    if array.dtype.startswith("float"):
        return values.astype(array.dtype)
    missing, scale = np.isnan(values), array.attributes.get("scale_factor", 1.0)
    steps = values / scale
    np.rint(steps, out=steps)
    steps[missing] = 0.0
    largest = max(steps.max(initial=0.0), -steps.min(initial=0.0))
    if largest > np.iinfo(array.dtype).max:
        raise OverflowError(
            f"{name}: {largest * scale:.3g} does not fit {array.dtype} in steps of {scale:g} "
            "(set dataset.displacement: float32)"
        )
    stored = steps.astype(array.dtype)
    stored[missing] = array.fill
    return stored


def _manifest(sums: Mapping[str, str], **head: int) -> bytes:
    return json.dumps({**head, "sha256": dict(sorted(sums.items()))}, indent=1).encode()
