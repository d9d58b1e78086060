"""Training with recordings in place of synthetic signals: with meshes, and without."""

import h5py
import numpy as np
import pytest

from simgen.dataset.splits import SPLITS
from simgen.errors import InputError
from simgen.learning.training.evaluate import evaluate
from simgen.learning.training.run import TrainingRun
from tests.learning import touched


def job(dataset, *files, networks=("svb", "mvb", "rmb", "s2mpn", "s2rm")):
    recordings = {"recordings": {"files": [str(file) for file in files]}}
    return touched.job(dataset.path, networks=list(networks), signals=recordings)


@pytest.fixture(scope="module")
def with_meshes(with_electrodes, tmp_path_factory):
    folder = tmp_path_factory.mktemp("recorded")
    return touched.train(job(with_electrodes, touched.record(folder / "a.h5")), folder / "networks")


def test_recordings_with_meshes_train_all_that_needs_signals(with_meshes):
    assert with_meshes.trained_names() == ["svb", "mvb", "s2mpn", "rmb", "s2rm"]
    signals = with_meshes.inputs.signals
    entries = evaluate(with_meshes, lambda items, about: items)
    own = [each for each in entries if each.task == "electrode signals -> biotac mesh"]
    assert [each.model for each in own if each.published or "ours" in each.model] == ["S2MPN", "S2RM (ours)"]
    for each in own:  # measured on the recordings' own test, whose indenters nobody knows
        assert np.array_equal(each.errors.rows, signals.rows("test").numpy())
        assert each.labels == {} and np.isnan(each.errors.overlap).all()
    # Nobody has recorded the DIGIT beside it.
    assert "electrode signals -> digit mesh" not in {each.task for each in entries}


def test_recordings_without_meshes_train_what_needs_none(with_electrodes, tmp_path):
    file = touched.record(tmp_path / "a.h5", meshes=False)
    run = touched.train(job(with_electrodes, file, networks=["svb"]), tmp_path / "networks")
    (entry,) = evaluate(run, lambda items, about: items)
    assert entry.model == "SVB" and len(entry.errors.rows) == len(run.inputs.signals.rows("test"))


@pytest.mark.parametrize("network", ["s2mpn", "s2rm"])
def test_recordings_without_meshes_are_told_before_anything_is_trained(with_electrodes, tmp_path, network):
    file = touched.record(tmp_path / "a.h5", meshes=False)
    with pytest.raises(InputError, match=r"signals.recordings: not all files hold meshes .* networks without these"):
        TrainingRun(job(with_electrodes, file, networks=["svb", "mvb", "rmb", network]), tmp_path / "networks", "cpu")
    assert not (tmp_path / "networks").exists()


def test_no_network_sees_the_test_of_a_recording(with_meshes, with_electrodes, tmp_path):
    file = touched.record(tmp_path / "a.h5")
    signals = with_meshes.inputs.signals
    with h5py.File(file, "a") as opened:
        force = np.linalg.norm(opened["force_vec/data"][()], axis=1)
        test = np.flatnonzero(force >= 0.1)[signals.split == list(SPLITS).index("test")]
        for key in ("electrode_vals/data", "nodal_res"):
            values = opened[key][()]
            values[test] *= 1.01
            opened[key][...] = values
    other = touched.train(job(with_electrodes, file), tmp_path / "networks")
    assert not np.array_equal(other.inputs.signals.values, signals.values)
    assert touched.weights(other.output) == touched.weights(with_meshes.output)


def test_a_recording_that_has_changed_is_another_job(with_electrodes, tmp_path):
    own = job(with_electrodes, touched.record(tmp_path / "a.h5"), networks=["svb"])
    TrainingRun(own, tmp_path / "networks", "cpu")
    (tmp_path / "a.h5").unlink()
    touched.record(tmp_path / "a.h5", meshes=False)
    with pytest.raises(InputError, match=r"was begun with another job: recordings\."):
        TrainingRun(own, tmp_path / "networks", "cpu")


def test_files_are_found_beside_the_job(with_electrodes, tmp_path):
    touched.record(tmp_path / "a.h5")
    beside = job(with_electrodes, "a.h5")
    beside._folder = tmp_path
    assert len(TrainingRun(beside, tmp_path / "networks", "cpu").inputs.signals.values) == 240  # four of five of 300
