"""The dataset: round trip, fill values, overflow, provenance, and shards that nobody shares."""

import json

import fake
import numpy as np
import pytest
import zarr

from dataset.shards import make, shard_values, write_shard
from simgen.config.job_schema import FINEST_STEP_M
from simgen.dataset.chunk_files import chunk_path
from simgen.dataset.reader import Dataset
from simgen.errors import InputError
from simgen.pipeline.run import run


def test_what_is_written_is_read_back(dataset):
    written = {shard: shard_values(dataset, shard) for shard in range(dataset.shards)}
    for shard, values in written.items():
        write_shard(dataset, shard, values)
    for name, array in dataset.arrays.items():
        expected = np.concatenate([values[name] for values in written.values()])
        stored = dataset[name]
        assert stored.shape == (dataset.presses, *array.shape)
        assert stored.dtype == array.dtype
        if name.endswith("displacement"):
            decoded = dataset.displacement(name.split("/")[0], slice(None))
            # Rounding to the nearest step is off by half a step, plus the last bits of the product.
            assert np.abs(decoded - expected).max() <= 0.5 * FINEST_STEP_M * (1 + 1e-9)
        else:
            np.testing.assert_array_equal(stored, expected)


def test_one_press_is_read_alone(dataset):
    """Also where another press's file is gone; a press that is not there yet has fill values."""
    for shard in (0, 1):
        write_shard(dataset, shard, shard_values(dataset, shard))
    names = ("digit/force", "biotac/status", "biotac/touch", "press/pose")
    expected = {name: dataset[name] for name in names}
    for name in names:
        np.testing.assert_array_equal(dataset.of_press(name, 3), expected[name][3])
        np.testing.assert_array_equal(dataset.of_press(name, 5), expected[name][5])
        (dataset.path / chunk_path(name, 0, dataset.array(name).ndim)).unlink()
        np.testing.assert_array_equal(dataset.of_press(name, 3), expected[name][3])
        with pytest.raises(InputError, match=f"{name}/.*: is gone"):
            dataset.of_press(name, 1)


def test_float32_displacement_is_a_choice_of_the_job(tmp_path):
    job = fake.make_job(dataset={"displacement": "float32", "presses_per_shard": 5})
    dataset = make(tmp_path / "d.zarr", job)
    values = shard_values(dataset, 0)
    write_shard(dataset, 0, values)
    expected = values["biotac/displacement"].astype(np.float32)
    np.testing.assert_array_equal(dataset.displacement("biotac", slice(0, 5)), expected)


def test_samples_that_were_not_reached_hold_the_fill_value(dataset):
    values = shard_values(dataset, 0)
    values["digit/displacement"][1, 2:] = np.nan
    values["digit/certificate/newton_iterations"][1, 2:] = np.nan
    values["digit/force"][1, 2:] = np.nan
    values["digit/status"][1, 2:] = 1
    write_shard(dataset, 0, values)
    reached = np.isfinite(dataset.displacement("digit", 1)).all(axis=(-1, -2))
    np.testing.assert_array_equal(reached, [True, True, False, False])
    np.testing.assert_array_equal(dataset["digit/status"][1, 2:], [1, 1])
    np.testing.assert_array_equal(dataset["digit/certificate/newton_iterations"][1, 2:], [-1, -1])
    assert np.isnan(dataset["digit/force"][1, 2:]).all()
    assert np.isnan(dataset.displacement("digit", 5)).all(), "a shard that nobody wrote reads as not reached"
    assert (dataset["digit/status"][2:] == -1).all()


def test_displacement_of_one_sample_is_one_chunk_and_scaled_by_its_attribute(dataset):
    array = zarr.open_group(dataset.path, mode="r")["biotac/displacement"]
    assert array.chunks == (1, 1, len(fake.VERTICES), 3)
    assert array.shards == (2, 4, len(fake.VERTICES), 3)
    assert array.attrs["scale_factor"] == FINEST_STEP_M


def test_walking_a_dataset_with_zarr_warns_of_nothing(dataset, recwarn):
    write_shard(dataset, 0, shard_values(dataset, 0))
    members = dict(zarr.open_group(dataset.path, mode="r").members(max_depth=None))
    assert set(dataset.arrays) <= set(members)
    assert not recwarn.list


def test_a_fluid_has_its_pressure_and_its_certificate_and_costs_the_others_nothing(tmp_path):
    plain, filled = (set(make(tmp_path / f"{n}.zarr", job).arrays) for n, job in enumerate(
        [fake.make_job(), fake.make_job(sensors=fake.FILLED)]))  # fmt: skip
    assert filled - plain == {"biotac/cavity_pressure", "biotac/certificate/liquid_volume_error"}
    assert plain < filled


@pytest.mark.parametrize("name", ["press/split", "depth", "digit/rest_positions", "digit/displacement", "biotac/force",
                                  "digit/touch"])  # fmt: skip
def test_a_file_that_is_gone_is_not_read_as_fill_values(tmp_path, name):
    """As after a copy that was interrupted: zarr alone would give zeros, or NaN that looks like a press that failed."""
    copy = tmp_path / "copy.zarr"
    presses = run(fake.make_plan(fake.make_job()), copy, build=fake.fake_presser).presses
    gone = next(file for file in sorted((copy / name / "c").rglob("*")) if file.is_file())
    gone.unlink()
    with pytest.raises(InputError, match=f"{gone.relative_to(copy)}: is gone, and its manifest says that it was"):
        Dataset(copy)[name]
    if name.endswith("displacement"):
        with pytest.raises(InputError, match="is gone"):
            Dataset(copy).displacement("digit", 0, 0)
        assert Dataset(copy).displacement("digit", presses - 1, 0).shape == (len(fake.VERTICES), 3)


def test_arrays_that_are_kept_are_not_read_again_until_they_are_dropped(tmp_path):
    dataset = run(fake.make_plan(fake.make_job()), tmp_path / "d.zarr", build=fake.fake_presser)
    whole = dataset["digit/status"]
    dataset.keep(1, ["digit/status"])
    (dataset.path / chunk_path("digit/status", 1, 2)).unlink()
    np.testing.assert_array_equal(dataset["digit/status"], whole)
    dataset.drop_kept()
    with pytest.raises(InputError, match="is gone"):
        dataset["digit/status"]


def test_an_array_of_another_type_than_the_job_s_is_refused(tmp_path):
    copy = run(fake.make_plan(fake.make_job()), tmp_path / "copy.zarr", build=fake.fake_presser).path
    for file in (copy / "digit/force/zarr.json", copy / "zarr.json"):  # zarr keeps a copy of all arrays' metadata
        text = file.read_text()
        found = json.loads(text)
        own = found if "data_type" in found else found["consolidated_metadata"]["metadata"]["digit/force"]
        own |= {"data_type": "int64", "fill_value": 0}
        file.write_text(json.dumps(found))
    with pytest.raises(InputError, match="digit/force: type int64; allowed: float"):
        Dataset(copy)["digit/force"]



def test_a_folder_that_is_no_dataset_is_refused(tmp_path):
    with pytest.raises(InputError, match="not a dataset"):
        Dataset(tmp_path)


ROTTEN = {
    "empty": lambda data: b"",
    "a part": lambda data: data[:15],
    "cut": lambda data: data[:-1],
    "lengths": lambda data: data[:4] + 8 * b"\xff" + data[12:],
    "all": lambda data: 64 * b"\xff",
}


@pytest.mark.parametrize("name", ["digit/status", "digit/displacement", "press/pose"])
@pytest.mark.parametrize("spoil", ROTTEN.values(), ids=ROTTEN)
def test_a_rotten_chunk_is_an_error_not_the_end_of_the_process(dataset, name, spoil):
    """c-blosc believes what a chunk says of its own length."""
    for shard in range(dataset.shards):
        write_shard(dataset, shard, shard_values(dataset, shard))
    file = dataset.path / chunk_path(name, 1, dataset.array(name).ndim)
    file.write_bytes(spoil(file.read_bytes()))
    with pytest.raises(InputError, match=f"{name}: cannot be read"):
        Dataset(dataset.path)[name]
    if not name.endswith("displacement"):
        with pytest.raises(InputError, match=f"{name}: cannot be read"):
            Dataset(dataset.path).of_press(name, 2)


def test_the_job_in_a_dataset_is_the_job(dataset):
    assert dataset.job.hash == fake.make_job().hash == dataset.attributes["job_hash"]
    assert json.loads((dataset.path / "zarr.json").read_text())["attributes"]["job"]["name"] == "fake"


def test_a_dataset_from_before_the_rule_of_thin_gel_has_its_job_and_hash(tmp_path):
    """Its job lacks the key, as that of a job which switches the rule off."""
    job = fake.make_job(trajectories={"count": 4, "least_thickness_left": 0.0})
    old = run(fake.make_plan(job), tmp_path / "d.zarr", build=fake.fake_presser)
    assert "least_thickness_left" not in old.attributes["job"]["trajectories"]
    assert Dataset(old.path).job.hash == old.attributes["job_hash"] == job.hash
