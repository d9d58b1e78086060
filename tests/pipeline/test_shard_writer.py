"""Writing a shard: arrays by sensor, poses at first touch, files that appear only when the shard is whole."""

import threading

import fake
import numpy as np
import pytest

from simgen.dataset.reader import Dataset
from simgen.dataset.writer import create, folder_aside
from simgen.errors import InputError
from simgen.pipeline import shard_files, shard_writer
from simgen.pipeline.shard_files import Failure, WritingThreads, writing
from simgen.pipeline.shard_writer import ShardWriter, put_shards_in_place


@pytest.fixture
def dataset(tmp_path):
    plan = fake.make_plan(fake.make_job())
    create(tmp_path / "d.zarr", plan.attributes, plan.arrays, plan.job)
    return Dataset(tmp_path / "d.zarr")


def write(dataset: Dataset, shards: range, build=fake.fake_presser) -> list[ShardWriter]:
    """Press and write shards; returns their writers."""
    indenter, contact = dataset["press/indenter"], dataset["press/contact_pose"]
    before = dataset.finished()
    with folder_aside(dataset) as folder, writing() as threads:
        writers = [ShardWriter(dataset, shard, folder, threads) for shard in shards]
        for sensor in dataset.sensors:
            presser = build(dataset.job, sensor, "cpu")
            for writer in writers:
                own = contact[writer.presses]
                writer.take(sensor, presser(indenter[writer.presses].tolist(), own), own)
        assert dataset.finished() == before
        put_shards_in_place(dataset, writers)
    return writers


@pytest.mark.parametrize(("build", "stays"), [(fake.fake_presser, True), (fake.missing_presser, False)])
def test_a_shard_that_is_solved_again_stays_finished_if_its_files_are_the_same(dataset, monkeypatch, build, stays):
    """As if a process died between the new files and the manifest."""
    write(dataset, range(dataset.shards))
    put, finished = shard_writer.put_in_place, []

    def watched(root, files):
        finished.append(dataset.finished())
        put(root, files)

    monkeypatch.setattr(shard_writer, "put_in_place", watched)
    write(dataset, range(1), build)
    assert finished[0] == ([0, 1, 2, 3, 4, 5] if stays else [1, 2, 3, 4, 5])
    assert dataset.unfinished() == []


def test_an_abandoned_shard_drops_what_waits_and_ends_what_is_being_written(dataset, monkeypatch):
    began, go_on, written = threading.Event(), threading.Event(), []

    def slow(dataset, shard, values, folder):
        began.set()
        go_on.wait(20.0)
        written.append(values)
        return {}

    monkeypatch.setattr(shard_files, "write_aside", slow)
    threads = WritingThreads(1)
    writer = ShardWriter(dataset, 0, dataset.path, threads)
    contact = dataset["press/contact_pose"][writer.presses]
    for sensor in dataset.sensors:
        press = fake.fake_presser(dataset.job, sensor, "cpu")
        writer.take(sensor, press(dataset["press/indenter"][writer.presses].tolist(), contact), contact)
    began.wait(20.0)
    threading.Timer(0.1, go_on.set).start()
    writer.abandon()
    assert len(written) == 1 and len(dataset.sensors) == 2
    threads.close()


def test_poses_are_at_first_touch_of_the_reference_sensor(dataset):
    """The fake press touches after 10, 20, 30 um of travel, by indenter, on both sensors."""
    write(dataset, range(dataset.shards))
    moved = dataset["press/pose"] - dataset["press/contact_pose"]
    travel = 1e-5 * (dataset["press/indenter"] + 1)
    np.testing.assert_allclose(moved[:, :3, 3], travel[:, None] * dataset["press/contact_pose"][:, :3, 1], atol=1e-15)
    assert not moved[:, :3, :3].any()
    np.testing.assert_array_equal(dataset["biotac/touch"], 0.0)


def test_a_press_that_never_touches_keeps_the_contact_pose(dataset):
    """The ring never touches the DIGIT; the fake press touches the BioTac after 20 um from the given pose."""
    write(dataset, range(dataset.shards), fake.missing_presser)
    ring = dataset["press/indenter"] == 1
    np.testing.assert_array_equal(np.isnan(dataset["digit/touch"]), ring)
    np.testing.assert_array_equal(dataset["press/pose"][ring], dataset["press/contact_pose"][ring])
    assert np.isfinite(dataset["press/pose"]).all()
    np.testing.assert_array_equal(dataset["biotac/touch"], np.where(ring, 2e-5, 0.0))


def test_results_are_stored_with_their_press_and_counted(dataset):
    (writer,) = write(dataset, range(2, 3), fake.failing_presser)
    assert dataset.finished() == [2] and writer.presses.tolist() == [4, 5]
    stalled = dataset["press/indenter"][4] == 1
    assert stalled and writer.outcomes == {1: 2 * 2}  # two sensors, two of four depths
    assert writer.seconds == {"digit": 0.02, "biotac": 0.02} and writer.failure is None
    expected = fake.fake_result(2, dataset["press/contact_pose"][5], dataset["depth"], 0.0)
    for name in ("force", "certificate/residual"):
        np.testing.assert_array_equal(dataset[f"biotac/{name}"][5], expected.outputs[name])


def test_a_shard_that_does_not_fit_is_left_out_with_its_reason(dataset):
    (first,) = write(dataset, range(1), fake.overflowing_presser)
    assert dataset.finished() == []
    assert first.failure.sentence.startswith("OverflowError: digit/displacement") and not first.failure.final


@pytest.mark.parametrize(
    ("error", "final"),
    [(InputError("bad"), True), (OSError(28, "No space left on device"), True), (OSError(5, "I/O error"), False),
     (RuntimeError("stalled"), False)],
)  # fmt: skip
def test_a_failure_is_final_if_a_second_try_would_fail_too(error, final):
    failure = Failure.of(error)
    assert failure.final == final and failure.errno == getattr(error, "errno", None)
    assert failure.sentence == f"{type(error).__name__}: {error}"
