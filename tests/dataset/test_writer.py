"""Writing a dataset: one file an array and shard, checksums, and who may write into a folder."""

import shutil

import fake
import numpy as np
import pytest
import zarr

from dataset.shards import make, shard_values, write_shard
from simgen.config.job_schema import FINEST_STEP_M
from simgen.dataset.writer import open_or_create
from simgen.errors import InputError


@pytest.mark.parametrize("steps, fits", [(32767.4, True), (-32767.4, True), (32767.6, False), (65536.0, False)])
def test_int16_rounds_or_refuses_but_never_wraps(dataset, steps, fits):
    values = shard_values(dataset, 0)
    values["digit/displacement"][0, 0, 0, 0] = steps * FINEST_STEP_M
    if fits:
        write_shard(dataset, 0, values)
        assert np.rint(dataset.displacement("digit", 0, 0)[0, 0] / FINEST_STEP_M) == np.rint(steps)
    else:
        with pytest.raises(OverflowError, match=r"digit/displacement: .* dataset.displacement: float32"):
            write_shard(dataset, 0, values)
        assert dataset.finished() == []


def test_a_shard_is_one_file_per_array_and_no_file_is_shared(dataset):
    empty = set(fake.contents(dataset.path))
    write_shard(dataset, 0, shard_values(dataset, 0))
    first = set(fake.contents(dataset.path)) - empty
    write_shard(dataset, 1, shard_values(dataset, 1))
    second = set(fake.contents(dataset.path)) - empty - first
    assert len(first) == len(second) == len(dataset.arrays) + 1  # and its manifest
    assert dataset.finished() == [0, 1]
    assert dataset.unfinished() == [2, 3, 4, 5]


def test_files_are_those_that_zarr_itself_makes(tmp_path):
    """All but the displacements, whose chunks zarrs puts into one file in another order; the last shard is short."""
    dataset = make(tmp_path / "d.zarr", fake.make_job(dataset={"presses_per_shard": 5}))
    theirs = tmp_path / "theirs.zarr"
    shutil.copytree(dataset.path, theirs)
    for shard in range(dataset.shards):
        values = shard_values(dataset, shard)
        values["biotac/force"][0] = np.nan
        write_shard(dataset, shard, values)
        presses = dataset.shard_presses(shard)
        for name in dataset.arrays:
            stored = dataset.root[name][presses.start : presses.stop]
            zarr.open_group(theirs, mode="r+")[name][presses.start : presses.stop] = stored
    plain = [name for name, array in dataset.arrays.items() if array.chunk is None]
    files = {name: sorted(p for p in (dataset.path / name).rglob("*") if p.is_file()) for name in plain}
    assert len(presses) == 2
    for name, ours in files.items():
        assert len(ours) == dataset.shards + 1, name  # and its zarr.json
        for file in ours:
            assert file.read_bytes() == (theirs / file.relative_to(dataset.path)).read_bytes(), file


def test_every_file_but_manifests_has_a_checksum(dataset):
    write_shard(dataset, 3, shard_values(dataset, 3))
    files = {name for name in fake.contents(dataset.path) if not name.startswith("manifest/")}
    assert files == {file for manifest in dataset.manifests() for file in dataset.sums_of(manifest)}


def test_another_job_into_an_existing_dataset_is_refused_with_the_difference(dataset):
    plan = fake.make_plan(fake.make_job(trajectories={"count": 5}))
    with pytest.raises(InputError, match=r"holds another dataset \(job.trajectories.count: 4 -> 5\)"):
        open_or_create(dataset.path, plan.attributes, plan.arrays, plan.job)


def test_the_same_sensors_in_another_order_are_another_dataset(dataset):
    plan = fake.make_plan(fake.make_job(sensors={"biotac": {"model": "biotac"}, "digit": {"model": "digit"}}))
    with pytest.raises(InputError, match=r"holds another dataset \(order of sensors\)"):
        open_or_create(dataset.path, plan.attributes, plan.arrays, plan.job)


def test_the_same_job_opens_what_is_there(dataset):
    write_shard(dataset, 2, shard_values(dataset, 2))
    plan = fake.make_plan(fake.make_job())
    assert open_or_create(dataset.path, plan.attributes, plan.arrays, plan.job).finished() == [2]


def test_only_a_dataset_that_was_there_is_checked(tmp_path, monkeypatch):
    """A check takes a tenth of a second, and the start of a run waits for it."""
    checked = []
    monkeypatch.setattr("simgen.dataset.writer.checked", lambda dataset: checked.append(dataset.path) or dataset)
    plan = fake.make_plan(fake.make_job())
    for times in (0, 1):
        opened = open_or_create(tmp_path / "d.zarr", plan.attributes, plan.arrays, plan.job)
        assert opened.unfinished() and len(checked) == times
