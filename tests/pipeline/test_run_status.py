"""How far a run is, from the files that it leaves."""

import json

import fake
import pytest

from simgen.dataset.reader import Dataset
from simgen.dataset.writer import filling, log_timing, open_or_create
from simgen.errors import InputError
from simgen.pipeline.run import run
from simgen.pipeline.run_status import outcomes, run_status
from simgen.pipeline.shard import run_shards


def write_timings(dataset, entries):
    lines = [json.dumps({"presses": 2, "failed": 0, "error": None, **entry}) for entry in entries]
    (dataset.path / "manifest/timings.jsonl").write_text("\n".join(lines) + "\n")


@pytest.fixture
def half(tmp_path):
    """A dataset of which three shards of six are there."""
    plan = fake.make_plan(fake.make_job())
    dataset = open_or_create(tmp_path / "d.zarr", plan.attributes, plan.arrays, plan.job)
    run_shards(dataset.path, [0, 1, 2], plan.job, "cpu", fake.failing_presser)
    return dataset


def test_a_run_that_is_under_way(half):
    """Shard 0 by an earlier run; then two of two presses each in ten seconds, of one task, written at the same time."""
    shards = [{"shard": i, "finished": 110.0, "failed": i} for i in (1, 2)]
    write_timings(half, [{"shard": 0, "finished": 5.0}, {"began": 100.0}, *shards])
    with filling(half):
        found = run_status(half, now=113.0)
        assert (found.presses, found.finished, found.failed) == (12, 6, 3)
        assert (found.rate, found.left_s, found.last_s) == (0.4, 15.0, 3.0)
        assert "process" in found.at_work
    assert run_status(half, now=113.0).left_s is None  # nobody is at work


def test_a_shard_that_was_not_written_is_named_until_it_is(half):
    write_timings(half, [
        {"shard": 1, "finished": 1.0, "error": "OSError: gone"},
        {"shard": 1, "finished": 2.0},
        {"shard": 4, "finished": 3.0, "error": "OverflowError: too far"},
    ])  # fmt: skip
    assert run_status(half).errors == {4: "OverflowError: too far"}


def test_a_dataset_without_a_shard(tmp_path):
    plan = fake.make_plan(fake.make_job())
    empty = open_or_create(tmp_path / "d.zarr", plan.attributes, plan.arrays, plan.job)
    found = run_status(empty)
    assert (found.finished, found.last_s, found.rate, found.left_s, found.errors) == (0, None, None, None, {})
    assert outcomes(empty) == {}


def test_a_line_that_a_kill_left_half_written_is_left_out(tmp_path):
    dataset = run(fake.make_plan(fake.make_job()), tmp_path / "d.zarr", build=fake.fake_presser)
    file = dataset.path / "manifest/timings.jsonl"
    file.write_text(file.read_text()[:-20])
    log_timing(dataset, {"shard": 7})
    assert [line.get("shard") for line in dataset.timings()] == [None, 0, 1, 2, 3, 4, 7]


def test_failures_are_counted_by_their_status(half):
    """The ring, one press in three, stalls at the last two of four depths on both sensors."""
    assert outcomes(half) == {"failed: Stalled.": 2 * 2 * 2}


def test_planned_ends_and_samples_inside_out_are_told_from_failures(tmp_path):
    """What is not there yet is no outcome."""
    plan = fake.make_plan(fake.make_job())
    dataset = open_or_create(tmp_path / "d.zarr", plan.attributes, plan.arrays, plan.job)
    run_shards(dataset.path, [0, 1, 2], plan.job, "cpu", fake.ending_presser)
    expected = {"not pressed: Too strong.": 2 * 2, "not pressed: No room.": 2 * 2 * 2, "inside out: Inside out.": 2 * 2}
    assert outcomes(dataset) == expected and run_status(dataset).failed == 0


def test_a_file_that_cannot_be_read_is_one_line(half):
    (half.path / "digit/status/c/0/0").write_bytes(b"rotten")
    with pytest.raises(InputError, match=r"d\.zarr/digit/status: cannot be read .*`simgen check` names the file"):
        outcomes(Dataset(half.path))
