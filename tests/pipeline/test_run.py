"""Runs with a press by formula: any number of workers, kills and interrupts give the same bytes."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import fake
import numpy as np
import psutil
import pytest

from simgen.dataset.atomic_files import put_in_place
from simgen.dataset.reader import Dataset
from simgen.dataset.writer import manifest_aside, open_or_create
from simgen.errors import InputError
from simgen.pipeline.plan import sensor_identity
from simgen.pipeline.run import PRESSES_PER_GPU_PROCESS, divide, run, shards_per_task
from simgen.pipeline.shard import run_shards
from simgen.pipeline.workers import Workers, start_workers
from simgen.sensors.sensor import load_sensor

CHILD = """
import sys, fake, pathlib, signal
from simgen.pipeline.run import run
from simgen.pipeline.workers import start_workers
if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell starts others that ignore it
    output, scheduler, build = pathlib.Path(sys.argv[1]), sys.argv[2] or None, getattr(fake, sys.argv[3])
    job = fake.make_job()
    with start_workers(job, "cpu", int(sys.argv[4]), scheduler, build) as workers:
        run(fake.make_plan(job), output, workers, build=build)
"""


def start(tmp_path: Path, output: Path, scheduler: str, build: str, workers: int = 2) -> subprocess.Popen:
    script = tmp_path / "child.py"
    script.write_text(CHILD)
    paths = [str(Path(fake.__file__).parent), *sys.path]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    command = [sys.executable, str(script), str(output), scheduler, build, str(workers)]
    return subprocess.Popen(command, env=environment, start_new_session=True)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """A dataset made in one go, in this process."""
    path = tmp_path_factory.mktemp("whole") / "d.zarr"
    run(fake.make_plan(fake.make_job()), path, build=fake.fake_presser)
    return path


def test_workers_do_not_change_the_bytes(whole, tmp_path):
    job, reports = fake.make_job(), []
    with start_workers(job, count=2, build=fake.fake_presser) as started:
        plan = fake.make_plan(job)
        run(plan, tmp_path / "d.zarr", started, on_report=reports.append, build=fake.fake_presser)
    assert sorted(report.shard for report in reports) == list(range(6))
    assert fake.contents(tmp_path / "d.zarr") == fake.contents(whole)


def test_kill_9_in_the_middle_and_a_second_run_give_the_same_bytes(whole, tmp_path):
    path = tmp_path / "d.zarr"
    assert start(tmp_path, path, "sync", "killed_presser").wait() == -signal.SIGKILL
    assert Dataset(path).finished() == [0, 1]
    run(fake.make_plan(fake.make_job()), path, build=fake.fake_presser)
    assert fake.contents(path) == fake.contents(whole)


def test_kill_9_while_a_shard_is_being_written_leaves_no_trace_after_a_second_run(whole, tmp_path):
    path = tmp_path / "d.zarr"
    job = fake.make_job()
    run(fake.make_plan(job), path, build=fake.fake_presser)
    # As if killed between the files of shard 1 and its manifest: some files there, one half-written aside.
    (path / "manifest" / "000001.json").unlink()
    (path / "digit/force/c/1/0/0").unlink()
    (path / ".staging").mkdir()
    (path / ".staging" / "half").write_bytes(b"half a chunk")
    run(fake.make_plan(job), path, build=fake.fake_presser)
    assert fake.contents(path) == fake.contents(whole)


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_a_crash_between_files_and_manifest_costs_that_shard_alone(whole, tmp_path, share):
    """The process ends when some or all files of the second shard are in place."""
    path, plan, calls = tmp_path / "d.zarr", fake.make_plan(fake.make_job()), []

    def crashing(root, files):
        calls.append(files)
        if len(calls) < 3:  # files and manifest of the first shard
            return put_in_place(root, files)
        put_in_place(root, dict(list(files.items())[: int(share * len(files))]))
        raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("simgen.pipeline.shard_writer.put_in_place", crashing)
        with pytest.raises(KeyboardInterrupt):
            run(plan, path, build=fake.fake_presser)
    assert Dataset(path).finished() == [0]
    run(plan, path, build=fake.fake_presser)
    assert fake.contents(path) == fake.contents(whole)


def test_interrupt_leaves_a_dataset_that_a_second_run_completes(whole, tmp_path):
    path = tmp_path / "d.zarr"
    child = start(tmp_path, path, "", "tiring_presser", workers=1)
    deadline = time.monotonic() + 60
    while not (path.exists() and Dataset(path).finished()):
        assert time.monotonic() < deadline and child.poll() is None
        time.sleep(0.05)
    os.killpg(child.pid, signal.SIGINT)  # the whole group, as a terminal does
    assert child.wait(timeout=30) != 0
    assert 0 < len(Dataset(path).finished()) < 6
    run(fake.make_plan(fake.make_job()), path, build=fake.fake_presser)
    assert fake.contents(path) == fake.contents(whole)


def test_a_finished_dataset_is_left_alone(whole):
    before = {file: file.stat().st_mtime_ns for file in whole.rglob("*") if file.is_file()}
    reports = []
    plan = fake.make_plan(fake.make_job())
    run(plan, whole, on_report=reports.append, build=fake.failing_presser)
    assert reports == []
    assert {file: file.stat().st_mtime_ns for file in whole.rglob("*") if file.is_file()} == before


def test_a_press_that_fails_is_a_row_with_its_status(tmp_path):
    path = tmp_path / "d.zarr"
    reports = []
    plan = fake.make_plan(fake.make_job())
    dataset = run(plan, path, on_report=reports.append, build=fake.failing_presser)
    ring = dataset["press/indenter"] == 1
    expected = np.where(ring[:, None] & (np.arange(4) >= 2), 1, 0)
    np.testing.assert_array_equal(dataset["digit/status"], expected)
    assert sum(report.failed for report in reports) == 2 * np.count_nonzero(expected)
    assert dataset.unfinished() == []


def test_planned_ends_and_samples_inside_out_are_no_failures(tmp_path):
    """Four trajectories, three indenters, four depths, two sensors."""
    reports = []
    dataset = run(fake.make_plan(fake.make_job()), tmp_path / "d.zarr", on_report=reports.append,
                  build=fake.ending_presser)  # fmt: skip
    counts = np.sum([(report.failed, report.planned, report.inside_out) for report in reports], axis=0)
    assert counts.tolist() == [0, 4 * 2 * (1 + 2), 4 * 2]
    codes, counts = np.unique(dataset["biotac/status"], return_counts=True)
    assert dict(zip(codes.tolist(), counts.tolist(), strict=True)) == {0: 4 * (3 + 2 + 3), 7: 4, 8: 8, 9: 4}


def test_a_task_that_raises_is_reported_and_its_shard_is_left_for_the_next_run(tmp_path):
    path = tmp_path / "d.zarr"
    reports = []
    plan = fake.make_plan(fake.make_job())
    dataset = run(plan, path, on_report=reports.append, build=fake.overflowing_presser)
    assert all("OverflowError: digit/displacement" in report.error for report in reports)
    assert dataset.unfinished() == list(range(6))


def test_a_solver_that_breaks_down_leaves_nothing_behind(tmp_path):
    plan = fake.make_plan(fake.make_job())
    dataset = open_or_create(tmp_path / "d.zarr", plan.attributes, plan.arrays, plan.job)
    before = fake.contents(dataset.path)
    with pytest.raises(RuntimeError, match="no solver"):
        run_shards(dataset.path, [0, 1, 2], plan.job, "cpu", fake.raising_presser)
    assert fake.contents(dataset.path) == before


def test_a_shard_that_cannot_be_written_does_not_take_the_others_with_it(whole, tmp_path, monkeypatch):
    """A displacement that does not fit in the first shard, a full disk for the manifest of the third."""

    def full(shard, files, folder):
        if shard == 2:
            raise OSError(28, "No space left on device")
        return manifest_aside(shard, files, folder)

    plan = fake.make_plan(fake.make_job())
    dataset = open_or_create(tmp_path / "d.zarr", plan.attributes, plan.arrays, plan.job)
    with monkeypatch.context() as disk:
        disk.setattr("simgen.pipeline.shard_writer.manifest_aside", full)
        reports = run_shards(dataset.path, [0, 1, 2, 3], plan.job, "cpu", fake.overflowing_presser)
    assert [bool(report.error) for report in reports] == [True, False, True, False]
    assert "OverflowError" in reports[0].error and "No space left" in reports[2].error
    assert dataset.finished() == [1, 3]
    run(plan, dataset.path, build=fake.fake_presser)
    assert fake.contents(dataset.path) == fake.contents(whole)


def test_a_file_of_somebody_else_that_may_not_be_read_does_not_end_the_run(tmp_path):
    """Only a dataset that cannot be written does: solving on would be in vain."""
    reports = []
    dataset = run(fake.make_plan(fake.make_job()), tmp_path / "d.zarr", None, on_report=reports.append,
                  build=fake.forbidden_presser)  # fmt: skip
    assert len(reports) == 6 and all("PermissionError" in report.error for report in reports)
    assert dataset.finished() == []


def test_what_is_solved_again_stays_until_it_is_replaced(whole, tmp_path):
    """A solver that breaks down costs nothing that was there; files are exchanged without their manifest."""
    path = tmp_path / "d.zarr"
    shutil.copytree(whole, path)
    run(fake.make_plan(fake.make_job()), path, build=fake.raising_presser, again=[1, 2])
    assert fake.contents(path) == fake.contents(whole)
    run(fake.make_plan(fake.make_job()), path, build=fake.failing_presser, again=[0])
    assert Dataset(path).unfinished() == [] and fake.contents(path) != fake.contents(whole)
    run(fake.make_plan(fake.make_job()), path, build=fake.fake_presser, again=[0])
    assert fake.contents(path) == fake.contents(whole)


def test_a_changed_job_is_refused(whole):
    with pytest.raises(InputError, match=r"depths_mm\.last: 0\.4 -> 0\.5"):
        changed = fake.make_job(depths_mm={"first": 0.1, "last": 0.5, "count": 4})
        run(fake.make_plan(changed), whole, build=fake.fake_presser)


def test_a_worker_that_is_killed_loses_no_shard(whole, tmp_path):
    """kill -9 of a worker process while it solves: another one takes its place and its task."""
    path = tmp_path / "d.zarr"
    child = start(tmp_path, path, "", "slow_presser")
    deadline = time.monotonic() + 60
    while not (path.exists() and Dataset(path).finished()):
        assert time.monotonic() < deadline and child.poll() is None
        time.sleep(0.05)
    processes = psutil.Process(child.pid).children(recursive=True)
    _, *workers = [process for process in processes if "forkserver" in " ".join(process.cmdline())]  # itself first
    assert len(workers) == 2
    workers[0].kill()
    assert child.wait(timeout=60) == 0
    assert fake.contents(path) == fake.contents(whole)


def test_a_press_that_kills_its_process_costs_its_shard_and_no_other(whole, tmp_path):
    """As one that takes all memory; shards that died beside it are solved, its own is left for a later run."""
    job, path, reports = fake.make_job(), tmp_path / "d.zarr", []
    with start_workers(job, count=2, build=fake.poisoned_presser) as workers:
        run(fake.make_plan(job), path, workers, on_report=reports.append, build=fake.poisoned_presser)
    assert sorted(report.shard for report in reports) == list(range(6))
    (failed,) = [report for report in reports if report.error]
    poisoned = [shard for shard in range(6) if fake.POISON in Dataset(path).shard_presses(shard)]
    assert [failed.shard] == Dataset(path).unfinished() == poisoned
    assert "3 processes died while they solved it, killed or out of memory" in failed.error
    run(fake.make_plan(job), path, build=fake.fake_presser)
    assert fake.contents(path) == fake.contents(whole)


def test_what_broke_down_once_is_tried_again(whole, tmp_path):
    """As a file system that was away for a moment."""
    fake.STUMBLED.clear()
    reports = []
    run(fake.make_plan(fake.make_job()), tmp_path / "d.zarr", on_report=reports.append, build=fake.stumbling_presser)
    assert len(reports) == 6 and not any(report.error for report in reports) and fake.STUMBLED
    assert fake.contents(tmp_path / "d.zarr") == fake.contents(whole)


def test_workers_that_are_not_needed_do_not_start(whole):
    """A finished dataset is not worth a process."""
    job = fake.make_job()
    with start_workers(job, count=2, build=fake.fake_presser) as workers:
        run(fake.make_plan(job), whole, workers, build=fake.fake_presser)
        assert "started" not in vars(workers)


@pytest.mark.parametrize("close", [False, True])
def test_workers_serve_another_run_unless_they_are_to_end_with_this_one(whole, tmp_path, close):
    job = fake.make_job()
    with start_workers(job, count=1, build=fake.fake_presser) as workers:
        run(fake.make_plan(job), tmp_path / "1.zarr", workers, build=fake.fake_presser, close_workers=close)
        if close:
            workers.wait_until_closed()
            assert workers.started[0].status == "closed"
        else:
            run(fake.make_plan(job), tmp_path / "2.zarr", workers, build=fake.fake_presser)
            assert fake.contents(tmp_path / "2.zarr") == fake.contents(whole)


def test_tasks_use_what_was_made_before_there_was_a_plan(tmp_path):
    """One presser for each sensor, of which the dataset has recorded what it is."""
    job = fake.make_job(sensors={"digit": {"model": "digit", "mesh": "coarse"}})
    plan = fake.make_plan(job)
    own = sensor_identity(job, "digit", load_sensor("digit", "coarse"))
    plan.attributes = {**plan.attributes, "sensors": {"digit": own}}
    with start_workers(job, count=1, build=fake.recorded_presser) as workers:
        client, _ = workers.started
        (worker,) = client.run(os.getpid).values()
        dataset = run(plan, tmp_path / "d.zarr", workers, build=fake.recorded_presser)
    record = Path(fake.RECORD.format(pid=worker))
    made = record.read_text()
    record.unlink()
    assert dataset.unfinished() == [] and made == "digit "


@pytest.mark.parametrize(
    ("shards", "processes", "threads", "tasks"),
    [(215, 2, 256, 215), (215, 2, 12, 22), (215, 8, 12, 24), (3, 4, 256, 3), (1, 1, 256, 1), (215, 1, 1, 2)],
)
def test_the_tasks_of_a_gpu_s_process_fill_it(shards, processes, threads, tasks):
    """36 presses in a shard: one in each of 256 tasks, ten in each of 12, or 108 in a process without threads."""
    job = fake.make_job(dataset={"presses_per_shard": 36})
    size = shards_per_task(shards, job, Workers("cuda", processes, tasks_at_once=threads))
    assert size == 1 or size * 36 * threads <= PRESSES_PER_GPU_PROCESS
    parts = divide(list(range(shards)), size)
    assert len(parts) == tasks and [shard for part in parts for shard in part] == list(range(shards))


def test_a_task_of_many_shards_writes_the_same_bytes(whole, tmp_path):
    plan = fake.make_plan(fake.make_job())
    dataset = open_or_create(tmp_path / "d.zarr", plan.attributes, plan.arrays, plan.job)
    reports = run_shards(dataset.path, [0, 1, 2, 3, 4, 5], plan.job, "cpu", fake.fake_presser)
    assert [report.shard for report in reports] == list(range(6))
    run(plan, dataset.path, build=fake.raising_presser)  # the card is left to write
    assert fake.contents(dataset.path) == fake.contents(whole)
