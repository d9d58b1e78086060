"""The layout of a dataset on disk, and its reader.

A dataset is one zarr v3 directory in SI units::

    <name>.zarr/
      attributes                                       resolved job and hash, code, packages, meshes, status
      depth (depth,)                                   m, from first touch, at each step of the indenters' path
      path/offset (depth, 3), turn, leg (depth,)       paths with legs only: m and rad in the contact frame; number
                                                       of the leg, 0 is the press
      press/trajectory, indenter (press,)              number of the contact; index into the job's indenters
      press/split (press,)                             0 train, 1 validation, 2 test: by trajectory; -1 none (only
                                                       if an indenter is left out)
      press/contact_pose (press, 4, 4)                 indenter -> shared frame, its tip at the contact point
      press/contact_normal (press, 3)                  outward, of the reference sensor, in the shared frame
      press/pose (press, 4, 4)                         contact_pose moved along its +y to first touch on the
                                                       reference sensor, or contact_pose if never touched
      refused/points, normals (contact, 3)             refused contacts, where an indenter would leave too little
                                                       gel: m in the shared frame; absent if there are none
      <sensor>/rest_positions (vertex, 3)              the output mesh in the sensor's own frame
      <sensor>/tetrahedra, surface_triangles, held, touchable
      <sensor>/pose (press, 4, 4)                      sensor -> shared frame: the unfolding transform
      <sensor>/pressable_steps (press,)                with too_thin: stop only: number of steps that leave enough gel
      <sensor>/touch (press,)                          travel from press/pose to first touch on this sensor;
                                                       NaN if never touched
      <sensor>/surface_vertices (s,)                   with outputs at the surface only: indices of its vertices
      <sensor>/height_map_depth (row, column)          with height_map only: m, depth of the surface at rest along
                                                       the optical axis, at each pixel; inf beside the gel
      <sensor>/* (press, depth, ...)                   the outputs of `simgen.config.outputs`: displacement, force,
                                                       status, certificate/*, ...
      README.md, presses.csv, croissant.json           the card, for people and machines (`simgen.dataset.card`)
      manifest/*.json                                  sha256 of every file of the plan and of finished shards
      manifest/timings.jsonl                           time, host and duration of runs and shards
      .lock                                            locked and signed by the process that fills the dataset

One task writes one shard: the same presses of every array, one file per array. Two writers never share a shard. Each
file is written aside, flushed to disk and renamed; the manifest comes last. A shard without a manifest does not exist,
so a run that was killed at any moment can go on. Steps that were not reached hold the fill value (NaN, -1, or -32768
in int16) and a status. Converged samples with an inverted element keep their values.
"""

import json
import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path

import numpy as np
import zarr

from simgen.config.indenter_path import IndenterPath
from simgen.config.job import job_from_resolved
from simgen.config.job_schema import Job
from simgen.dataset.chunk_files import check_frames, chunk_path, is_sharded, open_sharded, read_chunk
from simgen.dataset.stored_arrays import NOT_REACHED, REST_DEPTH, Array, axis_lengths, written_arrays
from simgen.errors import InputError, shown

SCHEMA = 1
# Attributes that every dataset has, and those that a dataset has unless it was imported.
ATTRIBUTES = {"job": dict, "job_hash": str, "status": dict}
RUN_ATTRIBUTES = {"sensors": dict, "indenters": dict}
PLAN = "plan.json"  # in the folder manifest/, as TIMINGS
TIMINGS = "timings.jsonl"
GROWING = ".growing"  # folder with the plan of added trajectories, until its files are in place

# Older datasets lack some of these.
ADDED_LATER = ("certificate/stabilised_elements", "certificate/damping", "certificate/least_det_F")


def manifest_name(shard: int) -> str:
    """Name of a shard's manifest in the folder manifest/."""
    return f"{shard:06d}.json"


class Dataset:
    """A dataset on disk, open for reading.

    ``dataset.displacement("biotac", press, depth)`` gives (vertex, 3) m, NaN where the press did not get to.
    ``dataset["biotac/force"]`` reads a whole array. ``dataset.root`` is the zarr group.
    Raises `InputError` if the path is not a dataset, or if a run is adding trajectories to it.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        if not os.path.isfile(self.path / "zarr.json"):
            raise InputError(f"{path}: not a dataset (a folder that `simgen run` wrote, with a zarr.json)")
        if (self.path / GROWING).exists():
            advice = "wait for its end; if it was killed, run its command again"
            raise InputError(f"{path}: a run is adding trajectories to it; {advice}")
        try:
            self.root = zarr.open_group(self.path, mode="r")
            self.attributes = dict(self.root.attrs)
        except Exception as error:  # zarr raises errors of many kinds
            raise InputError(f"{path}/zarr.json: not what `simgen run` wrote ({shown(str(error), 200)})") from None
        self._arrays: dict[str, zarr.Array] = {}  # by name, opened once
        self._open: dict[str, zarr.Array] = {}  # sharded arrays, read by zarrs
        self._kept: dict[tuple[str, int], np.ndarray] = {}  # by name and shard
        if self.attributes.get("schema") != SCHEMA:
            found = shown(repr(self.attributes.get("schema")))
            raise InputError(f"{path}: schema {found}; this version reads {SCHEMA}")
        for key, kind in (ATTRIBUTES | ({} if self.imported else RUN_ATTRIBUTES)).items():
            if not isinstance(self.attributes.get(key), kind):
                found = shown(repr(self.attributes[key])) if key in self.attributes else f"no {key}"
                raise InputError(f"{path}/zarr.json: not what `simgen run` wrote ({found}; {key} is a {kind.__name__})")

    def __getitem__(self, name: str) -> np.ndarray:
        """Read a whole array. Unfinished shards give fill values, whatever their files hold.

        Raises `InputError` if the array is missing, has another shape, or cannot be read.
        """
        array, stored = self.arrays.get(name), self.array(name)
        if array is None:
            for file in self.sums_of(PLAN):
                if file.startswith(f"{name}/c/"):
                    self._check_exists(file)
            with self._reading(name):
                check_frames(stored, self.path, name)
                return stored[...]
        if stored.shape != (self.presses, *array.shape):
            raise InputError(f"{self.path}/{name}: shape {stored.shape}; allowed: {(self.presses, *array.shape)}")
        if stored.dtype != array.dtype:
            raise InputError(f"{self.path}/{name}: type {stored.dtype}; allowed: {array.dtype}")
        values = np.full(stored.shape, array.fill, array.dtype)
        for shard in self.finished():
            presses = self.shard_presses(shard)
            values[presses.start : presses.stop] = self.of_shard(name, shard)
        return values

    def of_shard(self, name: str, shard: int) -> np.ndarray:
        """Read an array that tasks write, for the presses (n, ...) of one finished shard.

        Raises `InputError` if the array is missing or cannot be read, and for a file that is gone: zarr would read fill
        values instead.
        """
        if (name, shard) in self._kept:
            return self._kept[name, shard]
        presses, stored = self.shard_presses(shard), self.array(name)
        self._check_exists(chunk_path(name, shard, stored.ndim))
        with self._reading(name):
            if is_sharded(stored):
                return self._sharded(name)[presses.start : presses.stop]
            return read_chunk(self.path, name, shard, stored, presses)

    def keep(self, shard: int, names: Iterable[str]):
        """Read arrays of a finished shard, and keep them until `drop_kept`, even if its files change.

        Raises as `of_shard` does.
        """
        for name in names:
            self._kept.pop((name, shard), None)
            values = self.of_shard(name, shard)
            values.flags.writeable = False
            self._kept[name, shard] = values

    def drop_kept(self):
        """Read all arrays from their files again."""
        self._kept.clear()

    def _check_exists(self, file: str) -> None:
        if not (self.path / file).exists():
            raise InputError(f"{self.path}/{file}: is gone, and its manifest says that it was there")

    def get(self, name: str) -> np.ndarray | None:
        """Read a whole array; None if the dataset does not have it."""
        return self[name] if name in self.root else None

    def array(self, name: str) -> zarr.Array:
        """The zarr array of this name, unread. Raises `InputError` if there is none."""
        if name not in self._arrays:
            with self._reading(name):
                found = self.root.get(name)
            if not isinstance(found, zarr.Array):
                raise InputError(f"{self.path}: no array {name}")
            self._arrays[name] = found
        return self._arrays[name]

    @contextmanager
    def _reading(self, name: str) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # codecs and zarr raise errors of many kinds for spoiled bytes
            complaint = f"cannot be read ({shown(str(error), 200)}); `simgen check` names the file"
            raise InputError(f"{self.path}/{name}: {complaint}") from None

    @cached_property
    def job(self) -> Job:
        """The job. Relative paths start at the folder of its last run; at the current one if that is not known."""
        folders = [line["folder"] for line in self.timings() if isinstance(line.get("folder"), str)]
        source, folder = f"{self.path}: job", Path(folders[-1]) if folders else Path()
        return job_from_resolved(self.attributes["job"], source, folder=folder)

    def timings(self) -> list[dict]:
        """Records of started runs and ended shards, in order: time, host, outcome.

        Lines that a kill cut short are left out.
        """
        file = self.path / "manifest" / TIMINGS
        found = []
        for text in file.read_text(encoding="utf-8", errors="replace").splitlines() if file.exists() else ():
            with suppress(ValueError, RecursionError):
                found.append(json.loads(text))
        return [line for line in found if isinstance(line, dict)]

    @cached_property
    def sensors(self) -> tuple[str, ...]:
        return tuple(self.job.sensors)

    @property
    def imported(self) -> bool:
        """True if `simgen.dataset.exchange.importing` made it from foreign files, which say less."""
        return "source" in self.attributes

    @property
    def grown_from(self) -> tuple[int, ...]:
        """Numbers of trajectories before each growth, ascending."""
        return tuple(self.attributes.get("grown_from", ()))

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
        """The arrays that tasks write, by path, as this dataset should have them."""
        shapes = {}
        for sensor in self.sensors:
            wanted = [("rest_positions", "(vertex, 3)")]
            wanted += [("surface_vertices", "(vertex)")] * bool(self.job.surface_outputs(sensor))
            wanted += [(REST_DEPTH, "(row, column)")] * self.job.has_images(sensor)
            for name, axes in ((f"{sensor}/{key}", axes) for key, axes in wanted):
                shapes[name] = shape = self.array(name).shape
                if len(shape) != axes.count(",") + 1:
                    raise InputError(f"{self.path}/{name}: shape {shape}; allowed: {axes}")
        arrays = written_arrays(self.job, axis_lengths(self.job, shapes))
        lacking = tuple(key for key in ADDED_LATER if not any(f"{name}/{key}" in self.root for name in self.sensors))
        return {name: array for name, array in arrays.items() if not name.endswith(lacking)}

    def sentence(self, code: int) -> str:
        """The sentence of a status code."""
        return str(self.attributes["status"].get(str(code), f"Status {code}, which no version of simgen writes."))

    def shard_presses(self, shard: int) -> range:
        per_shard = self.job.dataset.presses_per_shard
        return range(shard * per_shard, min((shard + 1) * per_shard, self.presses))

    def _shards_of(self, press: int | slice) -> list[int]:
        some = np.arange(self.presses)[press]
        return np.unique(some // self.job.dataset.presses_per_shard).tolist()

    @cached_property
    def indenter_path(self) -> IndenterPath:
        """The path of every indenter."""
        return self.job.indenter_path

    def offsets_of(self, sensor: str) -> np.ndarray:
        """(press, depth, 3) m, offsets from first touch in the contact frame, with the depths of `depths_of`."""
        depths = self.depths_of(sensor)
        offsets = np.tile(self.indenter_path.offsets_m, (self.presses, 1, 1))
        offsets[..., 1] = depths
        return offsets

    def depths_of(self, sensor: str) -> np.ndarray:
        """(press, depth) m. Imported files may state depths of their own, which need not be evenly spaced."""
        depth = np.broadcast_to(self["depth"], (self.presses, len(self["depth"])))
        stated = self.get(f"{sensor}/stated_depth")
        return depth if stated is None else np.where(np.isfinite(stated), stated, depth)

    def finished(self) -> list[int]:
        """Numbers of the shards that have a manifest."""
        numbers = (int(name.removesuffix(".json")) for name in self.manifests() if name != PLAN)
        return [number for number in numbers if number < self.shards]

    def unfinished(self) -> list[int]:
        return sorted(set(range(self.shards)) - set(self.finished()))

    def displacement(self, sensor: str, press: int | slice, depth: int | slice = slice(None)) -> np.ndarray:
        """(..., vertex, 3) float64, m; NaN where not reached or not there yet."""
        stored, scale = self.stored_displacement(sensor, press, depth), self.displacement_scale(sensor)
        return stored.astype(np.float64) if scale is None else np.where(stored == NOT_REACHED, np.nan, stored * scale)

    def stored_displacement(self, sensor: str, press: int | slice, depth: int | slice = slice(None)) -> np.ndarray:
        """(..., vertex, 3) as stored: float32 in m, or int16 in steps of `displacement_scale`."""
        return self.of_samples(f"{sensor}/displacement", press, depth)

    def of_samples(self, name: str, press: int | slice, depth: int | slice = slice(None)) -> np.ndarray:
        """Read some presses and depths of an array that has a chunk for each sample, as stored."""
        for shard in self._shards_of(press):
            if (self.path / "manifest" / manifest_name(shard)).exists():
                self._check_exists(chunk_path(name, shard, 1 + len(self.arrays[name].shape)))
        with self._reading(name):
            return self._sharded(name)[press, depth]

    def of_press(self, name: str, press: int) -> np.ndarray:
        """Read one press of an array that has one chunk for each shard; fill values if the press is not there yet."""
        array, (shard,) = self.arrays[name], self._shards_of(press)
        if not (self.path / "manifest" / manifest_name(shard)).exists():
            return np.full(array.shape, array.fill, array.dtype)
        return self.of_shard(name, shard)[press - self.shard_presses(shard).start]

    def in_unit(self, name: str, press: int | slice, depth: int | slice = slice(None)) -> np.ndarray:
        """Read some presses and depths of an array that has a chunk for each sample, in its unit, as floats.

        NaN where not reached or not there yet.
        """
        stored, scale = self.of_samples(name, press, depth), self.arrays[name].attributes.get("scale_factor")
        return stored if scale is None else np.where(stored == NOT_REACHED, np.nan, stored * scale)

    def displacement_scale(self, sensor: str) -> float | None:
        """Step of stored displacements, m; None if they are stored in m."""
        name = f"{sensor}/displacement"
        with self._reading(name):
            return self._sharded(name).attrs.get("scale_factor")

    def _sharded(self, name: str) -> zarr.Array:
        if name not in self._open:
            self._open[name] = open_sharded(self.path, name)
        return self._open[name]

    def manifests(self) -> list[str]:
        """Names of all manifests, the plan's included."""
        names = (file.name for file in (self.path / "manifest").glob("*.json"))
        return sorted(name for name in names if name == PLAN or re.fullmatch(r"\d{6,}\.json", name))

    def shard_files(self, shard: int) -> set[str]:
        """Paths of all files of a shard without its manifest."""
        return {chunk_path(name, shard, 1 + len(array.shape)) for name, array in self.arrays.items()}

    def sums_of(self, manifest: str) -> dict[str, str]:
        """sha256 of each file that a manifest lists, by path in the dataset.

        Raises `InputError` if `simgen run` did not write the manifest.
        """
        try:
            return dict(json.loads((self.path / "manifest" / manifest).read_text())["sha256"])
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
            raise InputError(f"{self.path}/manifest/{manifest}: not a manifest ({error})") from None
