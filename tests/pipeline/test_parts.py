"""Parts of shards: any order and any process give the bytes of whole shards, and failures are reported once."""

from itertools import chain, zip_longest
from pathlib import Path
from types import SimpleNamespace

import fake
import numpy as np
import pytest
from dask.distributed import Client

from simgen.dataset.reader import Dataset
from simgen.dataset.writer import folder_aside, open_or_create
from simgen.errors import InputError
from simgen.fem.nonlinear.status import Status
from simgen.pipeline.local_cluster import TASKS_PER_GPU_PROCESS, local_cluster
from simgen.pipeline.parts import Parts
from simgen.pipeline.run import run
from simgen.pipeline.shard import room_for_parts, run_parts
from simgen.pipeline.workers import Workers

ORDERS = {
    "as given": chain,
    "shared first": lambda own, shared: chain(list(shared), own),
    "mixed": lambda own, shared: filter(None, chain.from_iterable(zip_longest(own, reversed(list(shared))))),
}


class TwoGpus(Workers):
    """As if two GPUs solved tasks; this process does, in a given order."""

    def __init__(self, order="as given"):
        super().__init__("cuda", 2, tasks_at_once=TASKS_PER_GPU_PROCESS)
        self.order, self.own, self.shared = ORDERS[order], [], []

    def map(self, function, arguments, shared=(), room=None):
        for task in self.order(arguments, shared):
            (self.own if task in arguments else self.shared).append(task)
            yield task, function(task)


def gpu_plan(job) -> SimpleNamespace:
    plan = fake.make_plan(job)
    plan.device = "cuda"
    return plan


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return run(fake.make_plan(fake.make_job()), tmp_path_factory.mktemp("whole") / "d.zarr", build=fake.fake_presser)


@pytest.mark.parametrize("order", ORDERS)
def test_parts_give_the_bytes_of_whole_shards_in_any_order(whole, tmp_path, order, monkeypatch):
    workers, reports = TwoGpus(order), []
    dataset = run(gpu_plan(fake.make_job()), tmp_path / "d.zarr", workers, on_report=reports.append,
                  build=fake.fake_presser)  # fmt: skip
    for tasks in (workers.own, workers.shared):
        assert sorted(shards for _, shards, *_ in tasks) == [[0, 1, 2], [3, 4, 5]]
    folder, presses = workers.shared[0][3][1], dataset.job.dataset.presses_per_shard
    monkeypatch.setattr("simgen.pipeline.shard.POOLS_BY_SENSOR", {"biotac": SimpleNamespace(room=3 * presses + 1)})
    assert room_for_parts(["biotac"], 3 * presses, folder) == (2, 2)
    assert room_for_parts(["biotac"], presses, folder / "another") == (0, 4)
    assert room_for_parts(["biotac", "digit"], presses, folder) is None
    assert fake.contents(dataset.path) == fake.contents(whole.path)
    assert sorted(report.shard for report in reports) == list(range(dataset.shards))
    assert all(set(report.seconds_by_sensor) == set(dataset.sensors) and not report.error for report in reports)


def test_processes_of_two_gpus_give_the_bytes_of_whole_shards(whole, tmp_path, monkeypatch):
    """They work in another folder than the command, whose output is relative to its own."""
    with local_cluster([{"CUDA_VISIBLE_DEVICES": name} for name in "01"]) as cluster, Client(cluster) as client:
        client.wait_for_workers(2)
        workers = Workers("cuda", 2, lambda: (client, {}), tasks_at_once=TASKS_PER_GPU_PROCESS)
        monkeypatch.chdir(tmp_path)
        dataset = run(gpu_plan(fake.make_job()), Path("d.zarr"), workers, build=fake.fake_presser)
    assert fake.contents(dataset.path) == fake.contents(whole.path)


@pytest.fixture
def empty(tmp_path):
    """A dataset without shards, and a folder for its parts."""
    plan = fake.make_plan(fake.make_job())
    dataset = open_or_create(tmp_path / "d.zarr", plan.attributes, plan.arrays, plan.job)
    with folder_aside(dataset) as folder:
        yield dataset, folder


def solve(dataset, shard, sensor, folder, build=fake.failing_presser):
    [part] = run_parts(dataset.path, [shard], dataset.job, "cpu", build, sensor, folder)
    return part


def test_a_shard_is_not_finished_before_its_last_part(empty):
    dataset, folder = empty
    parts = Parts(dataset, folder)
    for shard in (0, 2):
        assert parts.add(solve(dataset, shard, "biotac", folder)) == []
    assert parts.rest() == [] and dataset.finished() == []
    [report] = [*parts.add(solve(dataset, 0, "digit", folder)), *parts.rest()]
    parts.close()
    assert dataset.finished() == [0]
    failed = sum(np.count_nonzero(dataset[f"{sensor}/status"] == Status.NEWTON_STALLED) for sensor in dataset.sensors)
    assert (report.shard, report.presses, report.error) == (0, 2, None) and report.failed == failed > 0


def test_a_part_that_is_solved_twice_leaves_the_finished_shard_as_it_is(empty):
    """dask may solve a part again when a process dies, and a GPU then gives other bytes."""
    dataset, folder = empty
    parts = Parts(dataset, folder)
    for sensor in dataset.sensors:
        parts.add(solve(dataset, 0, sensor, folder))
    parts.rest()
    before = fake.contents(dataset.path)
    assert solve(dataset, 0, "digit", folder, fake.missing_presser).files
    assert dataset.finished() == [0]
    after = fake.contents(dataset.path)
    assert {path: after[path] for path in before} == before
    parts.close()


@pytest.mark.parametrize("order", ORDERS)
def test_a_sensor_that_fails_is_tried_again_with_all_sensors_and_reported_once(tmp_path, order):
    reports = []
    dataset = run(gpu_plan(fake.make_job()), tmp_path / "d.zarr", TwoGpus(order), on_report=reports.append,
                  build=fake.raising_presser)  # fmt: skip
    assert sorted(report.shard for report in reports) == list(range(dataset.shards)) and dataset.finished() == []
    assert all("no solver" in report.error for report in reports)


def test_what_failed_once_is_solved_the_second_time(whole, tmp_path):
    fake.STUMBLED.clear()
    reports = []
    dataset = run(gpu_plan(fake.make_job()), tmp_path / "d.zarr", TwoGpus(), on_report=reports.append,
                  build=fake.stumbling_presser)  # fmt: skip
    assert not any(report.error for report in reports) and len(reports) == dataset.shards
    assert fake.contents(dataset.path) == fake.contents(whole.path)


def test_a_part_that_cannot_be_written_is_reported_at_once(empty):
    """A displacement of the first shard does not fit. Solving its other part is in vain."""
    dataset, folder = empty
    [report] = Parts(dataset, folder).add(solve(dataset, 0, "digit", folder, fake.overflowing_presser))
    assert "OverflowError" in report.error and dataset.finished() == []


def test_other_parts_of_failed_shards_are_not_solved(tmp_path, monkeypatch):
    solved, reports = [], []

    def refuse(path, shards, job, device, build, sensor, folder):
        solved.append((sensor, shards))
        if shards == [0, 1, 2]:
            raise InputError("bad input")
        return run_parts(path, shards, job, device, build, sensor, folder)

    monkeypatch.setattr("simgen.pipeline.run.run_parts", refuse)
    dataset = run(gpu_plan(fake.make_job()), tmp_path / "d.zarr", TwoGpus(), on_report=reports.append,
                  build=fake.fake_presser)  # fmt: skip
    assert solved == [("digit", [0, 1, 2]), ("digit", [3, 4, 5]), ("biotac", [3, 4, 5])]
    assert {report.shard for report in reports if report.error} == {0, 1, 2} and dataset.finished() == [3, 4, 5]


def test_shards_that_no_worker_has_solved_are_reported(tmp_path):
    class Lost(TwoGpus):
        def map(self, function, arguments, shared=(), room=None):
            yield from super().map(function, arguments)

    reports = []
    run(gpu_plan(fake.make_job()), tmp_path / "d.zarr", Lost(), on_report=reports.append, build=fake.fake_presser)
    assert len(reports) == 6 and all("no worker solved it" in report.error for report in reports)


def test_a_full_disk_ends_the_run(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("simgen.pipeline.parts.manifest_aside", full)
    with pytest.raises(InputError, match="No space left"):
        run(gpu_plan(fake.make_job()), tmp_path / "d.zarr", TwoGpus(), build=fake.fake_presser)


def test_an_interrupted_run_goes_on(whole, tmp_path):
    """Parts without a manifest count as not written, whatever their files hold."""

    def stop(report):
        raise KeyboardInterrupt

    plan = gpu_plan(fake.make_job())
    with pytest.raises(KeyboardInterrupt):
        run(plan, tmp_path / "d.zarr", TwoGpus("mixed"), on_report=stop, build=fake.fake_presser)
    dataset = Dataset(tmp_path / "d.zarr")
    assert 0 < len(dataset.finished()) < dataset.shards
    assert np.isnan(dataset["digit/force"][list(dataset.shard_presses(dataset.unfinished()[0]))]).all()
    run(plan, dataset.path, TwoGpus(), build=fake.fake_presser)
    assert fake.contents(dataset.path) == fake.contents(whole.path)


def test_shards_that_are_solved_again_are_solved_whole(whole, tmp_path):
    path = tmp_path / "d.zarr"
    plan, workers = gpu_plan(fake.make_job()), TwoGpus()
    run(plan, path, TwoGpus(), build=fake.fake_presser)
    run(plan, path, workers, build=fake.fake_presser, again=[1])
    assert len(workers.own) == 1 and not workers.shared
    assert fake.contents(path) == fake.contents(whole.path)
