"""Datasets without presses, and values to fill them."""

import fake
import numpy as np

from simgen.dataset.atomic_files import put_in_place
from simgen.dataset.reader import Dataset
from simgen.dataset.writer import create, folder_aside, manifest_aside, write_aside


def make(path, job):
    plan = fake.make_plan(job)
    create(path, plan.attributes, plan.arrays, job)
    return Dataset(path)


def shard_values(dataset, shard, seed=0):
    """Random values of the right shapes for one shard, displacements up to 2 mm."""
    rng = np.random.default_rng([seed, shard])
    count = len(dataset.shard_presses(shard))
    values = {}
    for name, array in dataset.arrays.items():
        scale = 2e-3 if name.endswith("displacement") else 100.0
        values[name] = rng.uniform(-1, 1, (count, *array.shape)) * scale
        if array.dtype in ("int8", "int32"):
            values[name] = np.abs(np.rint(values[name]))
    return values


def write_shard(dataset, shard, values):
    with folder_aside(dataset) as folder:
        files = write_aside(dataset, shard, values, folder)
        put_in_place(dataset.path, files)
        put_in_place(dataset.path, manifest_aside(shard, files, folder))
