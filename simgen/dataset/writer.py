"""Functions that create a dataset, continue it, and write the files of its shards.

Unfinished files lie in a folder that its process locks and whose name begins with a dot. A folder that no process
locks was left by a killed process and is removed.
"""

import errno
import hashlib
import json
import os
import shutil
import time
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from zarr.codecs import BloscCodec

from simgen.config.job_schema import Job
from simgen.dataset import atomic_files
from simgen.dataset.atomic_files import Aside, flush, put_in_place, whole_folder
from simgen.dataset.card import has_card
from simgen.dataset.chunk_files import COMPRESSION, chunk_file, sharded_files
from simgen.dataset.folder_lock import LOCK, LockedError, locked, locked_new, remove_abandoned
from simgen.dataset.layout import checked
from simgen.dataset.provenance import difference
from simgen.dataset.reader import PLAN, SCHEMA, TIMINGS, Dataset, manifest_name
from simgen.dataset.stored_arrays import Array, axis_lengths, written_arrays
from simgen.errors import InputError, cannot_write, writing

STAGING = ".staging"
WAIT_FOR_WORKERS = 20.0  # s, for tasks of a killed run; dask's workers end within seconds


def create(path: Path, attributes: Mapping[str, Any], planned: Mapping[str, np.ndarray], job: Job) -> None:
    """Create a dataset with everything that is known before the first press. It appears whole or not at all.

    `planned` maps names such as ``press/trajectory`` or ``digit/rest_positions`` to arrays. If another process creates
    the same folder meanwhile, its dataset stays.
    """
    with suppress(FileExistsError), whole_folder(path) as folder:
        write_plan(folder, attributes, planned, job)


def write_plan(
    folder: Path, attributes: Mapping[str, Any], planned: Mapping[str, np.ndarray], job: Job
) -> None:
    """Fill an empty folder with everything that is known before the first press, and its manifest."""
    root = zarr.create_group(folder, attributes={"schema": SCHEMA, **attributes})
    for name, values in planned.items():
        root.create_array(name, data=np.asarray(values))
    lengths = axis_lengths(job, {name: np.shape(values) for name, values in planned.items()})
    for name, array in written_arrays(job, lengths).items():
        _create_written(root, name, array, job.presses, job.dataset.presses_per_shard)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # consolidated metadata are not in the standard, but save reads
        zarr.consolidate_metadata(folder)
    sums = {
        file.relative_to(folder).as_posix(): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in folder.rglob("*")
        if file.is_file() and file.name != LOCK
    }
    put_in_place(folder, {f"manifest/{PLAN}": atomic_files.write_aside(folder, _manifest(sums))})


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


def open_or_create(
    path: Path, attributes: Mapping[str, Any], planned: Mapping[str, np.ndarray], job: Job
) -> Dataset:
    """Create the dataset of this plan, or open that of an earlier, unfinished run.

    Raises `InputError` with the difference if the folder holds another job, code or mesh.
    """
    existed = path.exists()
    if not existed:
        with writing(path):
            create(path, attributes, planned, job)
    dataset = Dataset(path)
    check_same(dataset, as_stored(attributes))
    return checked(dataset) if existed else dataset


def as_stored(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """The attributes of a plan, in the form in which a dataset returns them."""
    return json.loads(json.dumps({"schema": SCHEMA, **attributes}))


def check_output(path: Path, job: Job) -> None:
    """Raise the `InputError` of `open_or_create` that needs no plan, before the plan is made, which is slow."""
    if path.exists():
        dataset = Dataset(path)
        if not grows(dataset, job):
            check_same(dataset, dataset.attributes | {"job": job.resolved(), "job_hash": job.hash})
        return
    above = next(parent for parent in path.absolute().parents if parent.exists())
    if not above.is_dir() or not os.access(above, os.W_OK):
        raise InputError(cannot_write(path, errno.EACCES if above.is_dir() else errno.ENOTDIR))


def has_all(path: Path, job: Job) -> bool:
    """True if a complete dataset of this job is there. Call `check_output` first."""
    if not path.exists():
        return False
    dataset = Dataset(path)
    return not grows(dataset, job) and complete(dataset)


def grows(dataset: Dataset, job: Job) -> bool:
    """True if the job is the dataset's with more trajectories."""
    if dataset.imported or job.trajectories.count <= dataset.job.trajectories.count:
        return False
    return json.dumps(with_count(job, dataset.job.trajectories.count)) == json.dumps(dataset.attributes["job"])


def with_count(job: Job, count: int) -> dict[str, Any]:
    """The resolved job with another number of trajectories; of given contacts, the first ones."""
    plain = job.resolved()
    trajectories = plain["trajectories"] | {"count": count}
    if given := trajectories.get("contacts"):
        trajectories["contacts"] = given[:count]
    return plain | {"trajectories": trajectories}


def check_same(dataset: Dataset, asked: Mapping[str, Any]) -> None:
    """Raise `InputError` with the difference unless the dataset has these attributes."""
    own = {key: value for key, value in dataset.attributes.items() if key != "grown_from"}
    asked = {key: value for key, value in asked.items() if key != "grown_from"}
    if own != asked or own["job_hash"] != asked["job_hash"]:
        changes = difference(own, asked)
        shown = (
            "; ".join(change for change in changes if not change.startswith("job_hash")) or "order of sensors"
        )
        raise InputError(f"{dataset.path}: holds another dataset ({shown}); remove it or choose another --output")


def complete(dataset: Dataset) -> bool:
    """True if nothing is left to write or to remove."""
    return not dataset.unfinished() and has_card(dataset) and not (dataset.path / STAGING).exists()


@contextmanager
def filling(dataset: Dataset) -> Iterator[None]:
    """Lock a dataset for writing, and remove what killed processes left.

    Raises `InputError` if another run has the lock, or if tasks of an earlier run are still writing.
    """
    staging = dataset.path / STAGING
    with ExitStack() as stack:
        try:
            with writing(dataset.path):
                stack.enter_context(locked(dataset.path))
        except LockedError as error:
            advice = "wait for its end, or choose another --output"
            raise InputError(f"{dataset.path}: {error} is writing into it; {advice}") from None
        deadline = time.monotonic() + WAIT_FOR_WORKERS
        while left := _remove_staged(staging):
            if time.monotonic() > deadline:
                raise InputError(f"{dataset.path}: a task of an earlier run still writes ({left}); wait for its end")
            time.sleep(0.1)
        try:
            yield
        finally:
            with suppress(OSError):  # a folder that cannot be removed does no harm
                remove_abandoned(staging.glob("*"))
                staging.rmdir()


def _remove_staged(staging: Path) -> str | None:
    with writing(staging):
        return remove_abandoned(staging.glob("*"))


@contextmanager
def folder_aside(dataset: Dataset) -> Iterator[Path]:
    """A folder for a task's unfinished files; it is removed at the end with all that is left in it."""
    folder = None
    try:
        with locked_new(lambda text: dataset.path / STAGING / text) as folder:
            yield folder
    finally:
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)


def write_aside(
    dataset: Dataset, shard: int, values: Mapping[str, Sequence[np.ndarray]], folder: Path
) -> dict[str, Aside]:
    """Write files of a shard's arrays to disk, not in their places yet; return them by path.

    `values` maps names of arrays to float arrays in SI units, one for each press. Raises `OverflowError` if a
    displacement does not fit the stored type.
    """
    presses, files = dataset.shard_presses(shard), {}
    for name, of_presses in values.items():
        array = dataset.arrays[name]
        if array.chunk:  # encode one press at a time, because float64 copies are large
            stored = np.stack([_encode(np.asarray(value), array, name) for value in of_presses])
            made = sharded_files(dataset.path, name, presses, stored, folder)
        else:
            stored = _encode(np.stack(of_presses), array, name)
            made = chunk_file(name, shard, stored, dataset.job.dataset.presses_per_shard, array.fill)
        files |= {path: atomic_files.write_aside(folder, data) for path, data in made.items()}
    return files


def manifest_aside(shard: int, files: Mapping[str, Aside], folder: Path) -> dict[str, Aside]:
    """Write the manifest of a shard with these files, not in its place yet; return it by path."""
    text = _manifest({path: file.sha256 for path, file in files.items()}, shard=shard)
    return {manifest_path(shard): atomic_files.write_aside(folder, text)}


def manifest_path(shard: int) -> str:
    return f"manifest/{manifest_name(shard)}"


def forget(dataset: Dataset, shards: Iterable[int]) -> None:
    """Remove the manifests of shards, so that they count as not written, also after a power cut."""
    manifests = [dataset.path / manifest_path(shard) for shard in shards]
    if there := [file for file in manifests if file.exists()]:
        for file in there:
            file.unlink()
        flush(dataset.path / "manifest")


def log_timing(dataset: Dataset, entry: Mapping[str, Any]) -> None:
    """Append a record to the timings. It begins with a line break, in case a kill has cut the last record short."""
    with writing(dataset.path), open(dataset.path / "manifest" / TIMINGS, "a", encoding="utf-8") as file:
        file.write("\n" + json.dumps(entry))


def _encode(values: np.ndarray, array: Array, name: str) -> np.ndarray:
    """Convert floats to the stored type; NaN becomes the fill value. Steps in that type stay as they are."""
    if array.dtype.startswith("float") or values.dtype == array.dtype:
        return values.astype(array.dtype, copy=False)
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
