"""Adding trajectories to a dataset: a job whose ``trajectories.count`` is raised goes on where the smaller one ended.

Contacts come from a sequence, so those of the smaller job are the first ones of the larger. The new plan is written
into a folder aside. Renaming this folder to `GROWING` commits the growth. If a run is killed after that, the next run
moves the remaining files into place. Finished shards stay as they are. Only a last shard that was not full is solved
again, with the presses that fill it.
"""

import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from simgen.config.job_schema import Job, hash_of
from simgen.dataset.atomic_files import flush, flush_tree
from simgen.dataset.card import forget_card
from simgen.dataset.folder_lock import LockedError, locked
from simgen.dataset.reader import GROWING, PLAN, Dataset
from simgen.dataset.splits import split_presses
from simgen.dataset.writer import as_stored, check_same, filling, folder_aside, forget, grows, with_count, write_plan
from simgen.errors import InputError, writing

# Planned arrays that have more rows with more trajectories; the others are the same.
GROW = ("press/", "refused/"), ("/pose", "/pressable_steps")
SAME_PLAN = 1e-9  # m and rad: another processor may round a contact otherwise


def grow(path: Path, attributes: Mapping[str, Any], planned: Mapping[str, np.ndarray], job: Job) -> None:
    """Add the trajectories that the job has and the dataset lacks. Do nothing for another job, or without a dataset.

    Arguments are those of `simgen.dataset.writer.open_or_create`. Raises `InputError` where code, sensors or indenters
    are others than the dataset's, where its contacts are not the first ones of the job, and while it is being filled.
    """
    finish_growth(path)
    if not path.exists() or not grows(Dataset(path), job):
        return
    with filling(Dataset(path)):
        dataset = Dataset(path)  # another run may have added trajectories before this one had the right to
        if grows(dataset, job):
            _grow(dataset, attributes, planned, job)


def _grow(dataset: Dataset, attributes: Mapping[str, Any], planned: Mapping[str, np.ndarray], job: Job) -> None:
    path, count = dataset.path, dataset.job.trajectories.count
    smaller = with_count(job, count)
    check_same(dataset, as_stored(attributes) | {"job": smaller, "job_hash": hash_of(smaller)})
    grown_from = [*dataset.grown_from, count]
    arrays = {name: _extended(dataset, name, np.asarray(values)) for name, values in planned.items()}
    arrays["press/split"] = split_presses(job, grown_from)
    with writing(path), folder_aside(dataset) as aside:
        write_plan(aside / GROWING, dict(attributes) | {"grown_from": grown_from}, arrays, job)
        flush_tree(aside / GROWING)
        forget_card(dataset)
        if dataset.presses % job.dataset.presses_per_shard:  # the last shard has room for more presses
            forget(dataset, [dataset.shards - 1])
        os.rename(aside / GROWING, path / GROWING)
        flush(path)
        _put_plan_in_place(path)


def finish_growth(path: Path) -> None:
    """Complete a growth that a kill has cut short, if there is one.

    Raises `InputError` if another process is doing so.
    """
    if (path / GROWING).exists():
        try:
            with writing(path), locked(path):
                _put_plan_in_place(path)
        except LockedError as error:
            raise InputError(f"{path}: {error} is adding trajectories to it; wait for its end") from None


def _extended(dataset: Dataset, name: str, values: np.ndarray) -> np.ndarray:
    """A planned array that begins with what the dataset has. Raises `InputError` if the two differ there."""
    beginnings, ends = GROW
    grows = name.startswith(beginnings) or name.endswith(ends)
    first_refused = name.startswith("refused/") and name not in dataset.root
    own = values[:0] if first_refused else dataset[name]
    first = values[: len(own)] if grows else values
    same = first.shape == own.shape and (
        name == "press/split" or np.allclose(first, own, rtol=0.0, atol=SAME_PLAN, equal_nan=True)
    )
    if not same:
        raise InputError(f"{dataset.path}/{name}: differs from what the job plans for these trajectories; allowed: a "
                         "larger trajectories.count, all else unchanged")  # fmt: skip
    return np.concatenate([own, values[len(own) :]])


def _put_plan_in_place(path: Path) -> None:
    """Move the files of the new plan to where the old ones are; whatever was moved already stays."""
    growing = path / GROWING
    new = {file.relative_to(growing).as_posix() for file in growing.rglob("*") if file.is_file()}
    manifest = f"manifest/{PLAN}"
    if manifest in new:  # the old one is still in its place
        old, kept = ({*json.loads((folder / manifest).read_text())["sha256"]} for folder in (path, growing))
        for name in old - kept:
            (path / name).unlink(missing_ok=True)
    last = [name for name in (manifest, "zarr.json") if name in new]
    for name in (*sorted(new - {*last}), *last):
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        os.replace(growing / name, path / name)
        flush((path / name).parent)
    shutil.rmtree(growing)
    flush(path)
