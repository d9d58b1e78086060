"""Growth of a dataset: a job with a larger ``trajectories.count`` adds trajectories to the dataset of the smaller job.

Contacts come from a sequence, so the larger job begins with the contacts of the smaller one. The new plan is written
into a folder aside, and renaming this folder to `GROWING` commits the growth. If a run is killed after that, the next
run moves the remaining files into place. Finished shards stay. Only a last shard that was not full is solved again, now
full.
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

# Beginnings and ends of names of planned arrays that grow with the trajectories.
GROW = ("press/", "refused/"), ("/pose", "/pressable_steps")
SAME_PLAN = 1e-9  # m and rad; another processor may round a contact differently


def grow(path: Path, attributes: Mapping[str, Any], planned: Mapping[str, np.ndarray], job: Job) -> None:
    """Add the trajectories that the job has and the dataset lacks; do nothing for another job or without a dataset.

    Arguments are those of `simgen.dataset.writer.open_or_create`. Raises `InputError` if code, sensors, indenters or
    first contacts differ from the dataset's, and while another run fills the dataset.
    """
    finish_growth(path)
    if not path.exists() or not grows(Dataset(path), job):
        return
    with filling(Dataset(path)):
        dataset = Dataset(path)  # read again: another run may have grown it before this one locked it
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
    """Complete a growth that a kill has interrupted. Raises `InputError` while another process completes it."""
    if (path / GROWING).exists():
        try:
            with writing(path), locked(path):
                _put_plan_in_place(path)
        except LockedError as error:
            raise InputError(f"{path}: {error} is adding trajectories to it; wait for its end") from None


def _extended(dataset: Dataset, name: str, values: np.ndarray) -> np.ndarray:
    """Append new rows of a planned array to the dataset's. Raises `InputError` if the first rows differ."""
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
    """Move the files of the new plan over the old ones; a second call moves the files that are left."""
    growing = path / GROWING
    new = {file.relative_to(growing).as_posix() for file in growing.rglob("*") if file.is_file()}
    manifest = f"manifest/{PLAN}"
    if manifest in new:  # the old manifest is still in place
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
