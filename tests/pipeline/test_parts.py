"""Parts of shards: any order and any process give the bytes of whole shards, and failures are reported once."""

from itertools import zip_longest
from types import SimpleNamespace

import fake
import numpy as np
import pytest
from dask.distributed import Client

from simgen.dataset.reader import Dataset
from simgen.dataset.writer import folder_aside, open_or_create
from simgen.errors import InputError
from simgen.fem.nonlinear.status import Status
from simgen.pipeline.parts import Parts
from simgen.pipeline.run import run
from simgen.pipeline.shard import run_parts
from simgen.pipeline.workers import TASKS_PER_GPU_PROCESS, Workers, local_cluster

ORDERS = {
    "as given": lambda own, shared: [*own, *shared],
    "shared first": lambda own, shared: [*shared, *own],
    "mixed": lambda own, shared: [
        task for pair in zip_longest(own, reversed(shared)) for task in pair if task is not None
    ],
}


class TwoGpus(Workers):
    """As if two GPUs solved tasks; this process does, in a given order."""

    def __init__(self, order="as given"):
        super().__init__("cuda", 2, tasks_at_once=TASKS_PER_GPU_PROCESS)
        self.order, self.own, self.shared = ORDERS[order], [], []

    def map(self, function, arguments, shared=(), shared_at_once=1):
        self.own += arguments
        self.shared += shared
        for task in self.order(arguments, shared):
            yield task, function(task)


def gpu_plan(job) -> SimpleNamespace:
    plan = fake.make_plan(job)
    plan.device = "cuda"
    return plan


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return run(fake.make_plan(fake.make_job()), tmp_path_factory.mktemp("whole") / "d.zarr", build=fake.fake_presser)


@pytest.mark.parametrize("order", ORDERS)
def test_parts_give_the_bytes_of_whole_shards_in_any_order(whole, tmp_path, order):
    workers, reports = TwoGpus(order), []
    dataset = run(gpu_plan(fake.make_job()), tmp_path / "d.zarr", workers, on_report=reports.append,
                  build=fake.fake_presser)  # fmt: skip
    for tasks in (workers.own, workers.shared):
        assert [shards for _, shards, *_ in tasks] == [[0, 1, 2], [3, 4, 5]]
    assert fake.contents(dataset.path) == fake.contents(whole.path)
    assert sorted(report.shard for report in reports) == list(range(dataset.shards))
    assert all(set(report.seconds_by_sensor) == set(dataset.sensors) and not report.error for report in reports)


def test_processes_of_two_gpus_give_the_bytes_of_whole_shards(whole, tmp_path):
    with local_cluster([{"CUDA_VISIBLE_DEVICES": name} for name in "01"]) as cluster, Client(cluster) as client:
        client.wait_for_workers(2)
        workers = Workers("cuda", 2, lambda: (client, []), tasks_at_once=TASKS_PER_GPU_PROCESS)
        dataset = run(gpu_plan(fake.make_job()), tmp_path / "d.zarr", workers, build=fake.fake_presser)
    assert fake.contents(dataset.path) == fake.contents(whole.path)


def test_a_shard_is_not_finished_before_its_last_part(tmp_path):
    plan = fake.make_plan(fake.make_job())
    dataset = open_or_create(tmp_path / "d.zarr", plan.attributes, plan.arrays, plan.job)
    with folder_aside(dataset) as folder:
        parts = Parts(dataset, folder)
        for shard in (0, 2):
            [part] = run_parts(dataset.path, [shard], plan.job, "cpu", fake.failing_presser, "biotac")
            assert parts.add(part) is None
        assert dataset.finished() == []
        [part] = run_parts(dataset.path, [0], plan.job, "cpu", fake.failing_presser, "digit")
        report = parts.add(part)
    assert dataset.finished() == [0]
    failed = sum(np.count_nonzero(dataset[f"{sensor}/status"] == Status.NEWTON_STALLED) for sensor in dataset.sensors)
    assert (report.shard, report.presses, report.error) == (0, 2, None) and report.failed == failed > 0


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


def test_a_part_that_cannot_be_written_is_reported_at_once(tmp_path):
    """A displacement of the first shard does not fit. Solving its other part is in vain."""
    plan = fake.make_plan(fake.make_job())
    dataset = open_or_create(tmp_path / "d.zarr", plan.attributes, plan.arrays, plan.job)
    with folder_aside(dataset) as folder:
        [part] = run_parts(dataset.path, [0], plan.job, "cpu", fake.overflowing_presser, "digit")
        report = Parts(dataset, folder).add(part)
    assert "OverflowError" in report.error and dataset.finished() == []


def test_a_full_disk_ends_the_run(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("simgen.pipeline.parts.manifest_of_sums", full)
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
