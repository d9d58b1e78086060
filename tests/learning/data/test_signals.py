"""Electrode signals: synthetic ones are the model's, recordings are split by blocks of time, bad ones are one line."""

import re
from dataclasses import replace

import h5py
import numpy as np
import pytest
import torch

from simgen.dataset.splits import SPLITS
from simgen.errors import InputError
from simgen.learning.data.schema import RecordingFiles, Signals
from simgen.learning.data.signals import BLOCKS, SignalData, read_signals, recorded
from simgen.sensing.electrodes.gaps import gauge_of
from simgen.sensing.electrodes.model import ElectrodeSettings, synthetic_signals, voltage
from simgen.sensing.electrodes.signals import in_contact, without_drift
from tests.learning import plain, touched


@pytest.fixture
def biotac(trained):
    return trained.inputs.source


def read(folder, meshes, *names, **settings) -> SignalData:
    return recorded(RecordingFiles(files=names, **settings), folder, 1, meshes)


def test_synthetic_signals_are_the_model_s_and_split_as_the_dataset(trained, with_electrodes):
    data, settings = trained.inputs.data, ElectrodeSettings(noise_v=0.01)
    found = read_signals(data, "biotac", Signals(synthetic=settings), None, 1)
    expected = synthetic_signals(with_electrodes, "biotac", data.press, data.step, settings)
    np.testing.assert_allclose(found.values.numpy(), expected, rtol=2**-24, atol=0)  # as float32
    assert np.array_equal(found.split, with_electrodes["press/split"][data.press])
    assert found.meshes is data.meshes["biotac"]
    rest = voltage(gauge_of(with_electrodes, "biotac").rest_gap, settings)
    np.testing.assert_allclose(found.rest.numpy(), rest, rtol=2**-24, atol=0)


def test_rest_of_recordings_is_where_they_are_pressed_least(tmp_path, biotac):
    """The hundredth of each file's samples with the least force, and all with no more: here every fifth is free."""
    counts, free = {"a.h5": 300, "b.h5": 100}, []
    for name, count in counts.items():
        with h5py.File(touched.record(tmp_path / name, count=count)) as file:
            free.append(file["electrode_vals/data"][4::5])
    found = read(tmp_path, biotac, *counts)
    np.testing.assert_allclose(found.rest.numpy(), np.concatenate(free).mean(axis=0), rtol=1e-6)


def test_recordings_are_those_in_contact_with_their_meshes(tmp_path, biotac):
    path = touched.record(tmp_path / "a.h5")
    found = read(tmp_path, biotac, "a.h5")
    with h5py.File(path) as file:
        signals, force, mesh = (file[key][()] for key in ("electrode_vals/data", "force_vec/data", "nodal_res"))
    contact = in_contact(force, 0.1)
    assert 0 < len(found.values) == contact.sum() < len(contact)
    np.testing.assert_allclose(found.values.numpy(), signals[contact], rtol=2**-24, atol=0)
    moved = found.meshes.displacement(torch.arange(len(found.values))).numpy()
    rest = biotac.rest.double().numpy()
    np.testing.assert_allclose(moved, mesh[contact] - rest, rtol=2**-24, atol=0)


def test_a_recording_is_split_by_blocks_of_time(tmp_path, biotac):
    """A hundred blocks; no block is in two splits, and shares are those of trajectories."""
    path = touched.record(tmp_path / "a.h5", count=1000)
    found = read(tmp_path, biotac, "a.h5", least_force_n=0.0)
    blocks = found.split.reshape(BLOCKS, 10)
    assert (blocks == blocks[:, :1]).all()
    counts = np.bincount(blocks[:, 0], minlength=len(SPLITS))
    assert counts.tolist() == [round(100 * share) for share in SPLITS.values()]
    with h5py.File(path, "a") as file:
        file["electrode_vals/data"][...] += 1.0
    assert np.array_equal(read(tmp_path, biotac, "a.h5", least_force_n=0.0).split, found.split)  # whatever it holds


def test_two_recordings_are_one_after_the_other_each_with_its_split(tmp_path, biotac):
    touched.record(tmp_path / "a.h5")
    touched.record(tmp_path / "b.h5", seed=1)
    a, both = read(tmp_path, biotac, "a.h5"), read(tmp_path, biotac, "a.h5", "b.h5")
    count = len(a.values)
    assert torch.equal(both.values[:count], a.values) and np.array_equal(both.split[:count], a.split)
    assert not np.array_equal(both.split[count:][:100], a.split[:100])
    assert len(both.values) == len(both.meshes.steps) > count


@pytest.mark.parametrize("again", ["a.h5", "./a.h5", "link.h5"])
def test_a_recording_that_is_listed_twice_is_one_line(tmp_path, biotac, again):
    """The second time its blocks would be in other splits."""
    touched.record(tmp_path / "a.h5")
    (tmp_path / "link.h5").symlink_to("a.h5")
    with pytest.raises(InputError, match=f"signals.recordings.files: {re.escape(again)} is listed twice; allowed: "):
        read(tmp_path, biotac, "a.h5", again)


def test_drift_is_taken_off_where_it_is_asked_for(tmp_path, biotac):
    path = touched.record(tmp_path / "a.h5")
    with h5py.File(path) as file:
        signals, contact = file["electrode_vals/data"][()], in_contact(file["force_vec/data"][()], 0.1)
    found = read(tmp_path, biotac, "a.h5", remove_drift=True).values.numpy()
    np.testing.assert_allclose(found, without_drift(signals, contact)[contact], rtol=2**-24, atol=0)
    assert not np.allclose(found, signals[contact])


def test_files_of_which_one_has_no_meshes_have_none(tmp_path, biotac):
    touched.record(tmp_path / "a.h5")
    touched.record(tmp_path / "b.h5", meshes=False)
    found = read(tmp_path, biotac, "a.h5", "b.h5")
    assert found.meshes is None
    with pytest.raises(InputError, match=r"signals.recordings: not all files hold meshes \(nodal_res\), which s2mpn"):
        found.with_meshes()


def test_a_mesh_of_another_sensor_is_one_line(tmp_path):
    touched.record(tmp_path / "a.h5")
    with pytest.raises(InputError, match=r"a.h5: nodal_res: 324 vertices; allowed: 12, as digit has"):
        read(tmp_path, plain.random_meshes(3), "a.h5")


def test_a_recording_without_contact_is_one_line(tmp_path, biotac):
    touched.record(tmp_path / "a.h5")
    with pytest.raises(InputError, match=r"a.h5: no sample has a force of 100 N; allowed: some contact"):
        read(tmp_path, biotac, "a.h5", least_force_n=100.0)


def test_drift_that_nothing_tells_of_is_one_line(tmp_path, biotac):
    touched.record(tmp_path / "a.h5")
    with pytest.raises(InputError, match=r"a.h5: drift: 0 samples without contact; allowed: 2 or more"):
        read(tmp_path, biotac, "a.h5", least_force_n=0.0, remove_drift=True)


def test_a_file_that_is_gone_is_one_line(tmp_path, biotac):
    with pytest.raises(InputError, match=r"gone.h5: cannot be read as HDF5"):
        read(tmp_path, biotac, "gone.h5")


def test_the_range_is_that_of_the_training(tmp_path, biotac):
    touched.record(tmp_path / "a.h5")
    found = read(tmp_path, biotac, "a.h5")
    train = found.rows("train")
    others = found.values.clone()
    others[found.rows("validation")] += 1e6
    others[found.rows("test")] -= 1e6
    low, high = replace(found, values=others).bounds()
    torch.testing.assert_close(low.float(), found.values[train].min(dim=0).values, rtol=0.0, atol=0.0)
    torch.testing.assert_close(high.float(), found.values[train].max(dim=0).values, rtol=0.0, atol=0.0)


def test_a_split_without_samples_is_one_line():
    alone = SignalData(torch.zeros(4, 19), np.zeros(4, int), None, torch.zeros(19))
    assert len(alone.rows("train")) == 4
    with pytest.raises(InputError, match="signals: no sample of split test, 4 in all"):
        alone.rows("test")
