"""Samples for training, against the dataset's own arrays, and in torch's loaders with processes of their own."""

import shutil
import subprocess
import sys

import fake
import numpy as np
import pytest

from simgen import load_dataset
from simgen.config.job_schema import FINEST_STEP_M
from simgen.dataset.reader import Dataset
from simgen.errors import InputError
from simgen.pipeline.run import run

JOB = {"trajectories": {"count": 20}}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Twenty trajectories, three indenters, four depths; the ring stalls from the third depth on."""
    path = tmp_path_factory.mktemp("loading") / "fake.zarr"
    return run(fake.make_plan(fake.make_job(**JOB)), path, build=fake.failing_presser)


def test_samples_are_those_that_converged(dataset):
    samples = load_dataset(dataset.path)
    assert len(samples) == 20 * (4 + 2 + 4)
    found = {(sample["press"], round(float(sample["depth"]) * 1e4) - 1) for sample in samples}
    assert found == {tuple(row) for row in np.argwhere(dataset["digit/status"] == 0)}


def test_samples_inside_out_are_left_out_unless_asked_for(tmp_path):
    path = run(fake.make_plan(fake.make_job()), tmp_path / "d.zarr", build=fake.ending_presser).path
    valid, all_of_them = load_dataset(path), load_dataset(path, include_inside_out=True)
    assert (len(valid), len(all_of_them)) == (4 * (3 + 2 + 3), 4 * (3 + 2 + 4))
    more = {tuple(row) for row in all_of_them.rows} - {tuple(row) for row in valid.rows}
    assert more == {(3 * i + 2, 1) for i in range(4)}
    added = all_of_them[[tuple(row) for row in all_of_them.rows].index((2, 1))]
    assert all(np.isfinite(value).all() for value in added.values())


def test_samples_with_an_error_below_a_figure(tmp_path):
    """Estimates grow with depth, and one is unknown; the figure holds on all loaded sensors."""
    outputs = {sensor: ["surface_error_estimate_m"] for sensor in ("digit", "biotac")}

    def presser(job, sensor, device):
        def with_estimates(indenters, poses):
            results = fake.fake_presser(job, sensor, device)(indenters, poses)
            for result in results:
                result.outputs["surface_error_estimate_m"] = np.array([1e-6, 2e-6, 3e-6, np.nan])
                result.outputs["surface_error_estimate_m"] += 0.5e-6 * (sensor == "biotac")
            return results

        return with_estimates

    path = run(fake.make_plan(fake.make_job(outputs=outputs)), tmp_path / "d.zarr", build=presser).path
    counts = [len(load_dataset(path, max_error_um=limit)) for limit in (5.0, 3.2, 2.6)]
    assert counts == [12 * 3, 12 * 2, 12 * 2]
    assert len(load_dataset(path, max_error_um=1.2, sensors=["digit"])) == 12
    assert float(load_dataset(path)[0]["biotac/surface_error_estimate_m"]) == pytest.approx(1.5e-6)
    with pytest.raises(InputError, match=r"no sample .* is valid, with an estimated error of at most 1\.2 um"):
        load_dataset(path, max_error_um=1.2)


def test_without_estimates_a_limit_says_how_to_get_them(dataset):
    with pytest.raises(InputError, match=r"max_error_um: digit has no error estimates; .*surface_error_estimate_m"):
        load_dataset(dataset.path, max_error_um=5.0)


def test_a_sample_is_what_the_dataset_holds(dataset):
    samples = load_dataset(dataset.path, sensors=["biotac"])
    sample, (press, step) = samples[37], samples.rows[37]
    assert not any(name.startswith("digit/") for name in sample)
    rest, pose = dataset["biotac/rest_positions"], dataset["press/contact_pose"][press]
    expected = fake.fake_result(int(sample["indenter"]), pose, dataset["depth"], 0.0)
    error = np.abs(sample["biotac/displacement"] - expected.displacement[step]).max()
    assert error <= 0.5 * FINEST_STEP_M + np.spacing(np.float32(4e-4))  # stored in steps, read as float32
    np.testing.assert_allclose(sample["biotac/force"], expected.force[step], rtol=1e-6)
    assert sample["biotac/displacement"].shape == rest.shape == samples.rest_positions["biotac"].shape
    assert sample["depth"] == np.float32(dataset["depth"][step])
    assert sample["trajectory"] == dataset["press/trajectory"][press]
    assert {value.dtype for name, value in sample.items() if "/" in name} == {np.dtype(np.float32)}


def test_splits_share_no_trajectory_and_are_all_there_is(dataset):
    parts = {split: load_dataset(dataset.path, split) for split in ("train", "validation", "test")}
    assert sum(map(len, parts.values())) == len(load_dataset(dataset.path))
    trajectories = [set(dataset["press/trajectory"][part.rows[:, 0]]) for part in parts.values()]
    assert [len(each) for each in trajectories] == [16, 2, 2]
    assert len(set.union(*trajectories)) == 20


def test_an_indenter_that_is_left_out(dataset):
    test, train = (load_dataset(dataset.path, split, left_out="ring_7mm") for split in ("test", "train"))
    ring = dataset.indenters.index("ring_7mm")
    assert {int(sample["indenter"]) for sample in test} == {ring} and len(test) == 2 * 2
    assert ring not in {int(sample["indenter"]) for sample in train} and len(train) == 16 * 8


def test_a_dataset_that_leaves_an_indenter_out_gives_the_same_samples(dataset, tmp_path):
    job = fake.make_job(**JOB, dataset={"presses_per_shard": 2, "leave_out": "ring_7mm"})
    own = run(fake.make_plan(job), tmp_path / "own.zarr", build=fake.failing_presser)
    for split in ("train", "validation", "test"):
        expected = load_dataset(dataset.path, split, left_out="ring_7mm").rows
        np.testing.assert_array_equal(load_dataset(own.path, split).rows, expected)
        np.testing.assert_array_equal(load_dataset(own.path, split, left_out="ring_7mm").rows, expected)
    with pytest.raises(InputError, match="left_out 'sphere_7mm': allowed: ring_7mm, which the dataset leaves out"):
        load_dataset(own.path, left_out="sphere_7mm")


@pytest.mark.parametrize("wrong, words", [
    ({"split": "training"}, "split 'training': allowed: train, validation, test"),
    ({"sensors": ["finger"]}, "sensor 'finger': allowed: digit, biotac"),
    ({"sensors": []}, "no sensor is asked for; allowed: digit, biotac"),
    ({"left_out": "ring"}, "left_out 'ring': allowed: sphere_7mm, ring_7mm, texture_14mm"),
])  # fmt: skip
def test_names_that_are_not_there(dataset, wrong, words):
    with pytest.raises(InputError, match=words):
        load_dataset(dataset.path, **wrong)


def test_numbers_beyond_the_end_and_from_it(dataset):
    samples = load_dataset(dataset.path)
    assert samples[-1]["press"] == samples[len(samples) - 1]["press"] == 59
    with pytest.raises(IndexError):
        samples[len(samples)]
    some = samples[3:7]
    assert len(some) == 4 and some[0]["press"] == samples[3]["press"]


def test_a_fluid_s_pressure(tmp_path):
    filled = run(fake.make_plan(fake.make_job(sensors=fake.FILLED)), tmp_path / "d.zarr", build=fake.fake_presser)
    sample = load_dataset(filled.path)[2]
    assert sample["biotac/cavity_pressure"] == np.float32(filled["biotac/cavity_pressure"][0, 2])
    assert "digit/cavity_pressure" not in sample


def test_a_split_without_samples_is_said(tmp_path):
    small = run(fake.make_plan(fake.make_job(trajectories={"count": 1})), tmp_path / "d.zarr", build=fake.fake_presser)
    with pytest.raises(InputError, match="of split 'test' is valid; presses: train 3, validation 0, test 0"):
        load_dataset(small.path, "test")


@pytest.mark.parametrize("start", ["fork", "spawn"])
def test_torch_reads_them_in_processes_of_its_own(dataset, start):
    """Also after this process has read: what it has opened is of no use to a child."""
    torch = pytest.importorskip("torch", reason="torch is not installed (the training extra)")
    samples = load_dataset(dataset.path, "train")
    first = samples[0]
    loader = torch.utils.data.DataLoader(
        samples.torch(), batch_size=5, num_workers=2, multiprocessing_context=start, timeout=60
    )
    batches = list(loader)
    assert sum(len(batch["press"]) for batch in batches) == len(samples)
    assert batches[0]["digit/displacement"].shape == (5, len(fake.VERTICES), 3)
    np.testing.assert_array_equal(batches[0]["digit/displacement"][0], first["digit/displacement"])
    assert batches[0]["digit/force"].dtype == torch.float32 and batches[0]["indenter"].dtype == torch.int64


def test_samples_load_without_torch(dataset):
    code = f"import sys, simgen; simgen.load_dataset({str(dataset.path)!r})[0]; assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_an_unfinished_dataset_gives_what_is_there(dataset, tmp_path):
    shutil.copytree(dataset.path, tmp_path / "part.zarr")
    (tmp_path / "part.zarr" / "manifest" / "000000.json").unlink()
    gone = set(Dataset(tmp_path / "part.zarr").shard_presses(0))
    there = {int(sample["press"]) for sample in load_dataset(tmp_path / "part.zarr")}
    assert there == set(range(60)) - gone
