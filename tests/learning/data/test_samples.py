"""A dataset as tensors, against the dataset's own arrays; splits share no trajectory."""

import fake
import numpy as np
import pytest
import torch

from simgen.dataset.reader import Dataset
from simgen.dataset.splits import SPLITS
from simgen.errors import InputError
from simgen.fem.nonlinear.status import Status
from simgen.learning.data.samples import load_training_data
from tests.learning.conftest import make_dataset

CPU = torch.device("cpu")


def plain(items, about):
    return items


def test_rows_are_the_samples_that_converged_on_both(data, learnable):
    converged = (learnable["digit/status"] == 0) & (learnable["biotac/status"] == 0)
    assert len(data) == converged.sum() == 12 * (4 + 2 + 4)
    assert np.array_equal(np.stack([data.press, data.step], axis=1), np.argwhere(converged))
    assert np.array_equal(data.depth, learnable["depth"][data.step])


def test_samples_inside_out_are_left_out(tmp_path):
    path = make_dataset(tmp_path / "d.zarr").path
    before = load_training_data(path, ("digit", "biotac"), CPU, plain)
    fake.change(Dataset(path), "biotac/status", (2, 3), Status.INSIDE_OUT)
    after = load_training_data(path, ("digit", "biotac"), CPU, plain)
    kept = (before.press != 2) | (before.step != 3)
    assert np.count_nonzero(~kept) == 1
    np.testing.assert_array_equal(np.stack([after.press, after.step]), np.stack([before.press, before.step])[:, kept])
    assert torch.equal(after.meshes["digit"].steps, before.meshes["digit"].steps[torch.from_numpy(kept)])


@pytest.mark.parametrize("sensor", ["digit", "biotac"])
def test_displacements_are_the_dataset_s(data, learnable, sensor):
    rows = torch.tensor([3, 77, 20, 3])
    found = data.meshes[sensor].displacement(rows).numpy()
    for row, own in zip(rows.tolist(), found, strict=True):
        expected = learnable.displacement(sensor, int(data.press[row]), int(data.step[row]))
        # float32 of whole steps of 0.1 um; no step is lost
        np.testing.assert_allclose(own, expected, rtol=2**-23, atol=0)


def test_float32_datasets_are_read_as_they_are(tmp_path):
    dataset = make_dataset(tmp_path / "float.zarr", dataset={"displacement": "float32", "presses_per_shard": 5})
    data = load_training_data(dataset.path, ("digit",), CPU, plain)
    expected = dataset.displacement("digit", int(data.press[50]), int(data.step[50]))
    assert np.array_equal(data.meshes["digit"].displacement(torch.tensor([50]))[0].numpy(), expected)


def test_splits_share_no_trajectory(data, learnable):
    rows = {split: data.rows(split).numpy() for split in SPLITS}
    assert sum(map(len, rows.values())) == len(data)
    trajectories = [set(learnable["press/trajectory"][data.press[own]]) for own in rows.values()]
    assert all(trajectories) and len(set.union(*trajectories)) == sum(map(len, trajectories)) == 12


def test_a_split_without_samples_is_one_line(tmp_path):
    dataset = make_dataset(tmp_path / "few.zarr", trajectories={"count": 2})
    data = load_training_data(dataset.path, ("digit",), CPU, plain)
    with pytest.raises(InputError, match=r"few.zarr: no sample of split test; samples: train 20, validation 0, test 0"):
        data.rows("test")


def test_a_sensor_that_is_not_there_is_one_line(learnable):
    with pytest.raises(InputError, match="sensor 'finger': allowed: digit, biotac"):
        load_training_data(learnable.path, ("finger",), CPU, plain)


def test_an_indenter_that_is_left_out_is_tested_alone(learnable, data):
    name = learnable.indenters[1]
    without = load_training_data(learnable.path, ("digit", "biotac"), CPU, plain, leave_out=name)
    tested = without.indenter[without.rows("test").numpy()]
    trained = np.concatenate([without.indenter[without.rows(split).numpy()] for split in ("train", "validation")])
    assert set(tested) == {1} and set(trained) == set(range(len(learnable.indenters))) - {1}
    assert torch.equal(without.rows("test"), data.rows("test")[data.indenter[data.rows("test")] == 1])


def test_an_indenter_that_is_not_there_is_one_line(learnable):
    with pytest.raises(InputError, match="leave_out 'spoon': allowed: "):
        load_training_data(learnable.path, ("digit",), CPU, plain, leave_out="spoon")
