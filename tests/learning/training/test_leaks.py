"""Nothing that the test's trajectories hold decides anything: not a weight, not a normalisation, not when to stop."""

import shutil
from pathlib import Path

import fake
import numpy as np
import pytest

from simgen.dataset.reader import Dataset
from simgen.dataset.splits import SPLITS
from simgen.learning.data.registry import NETWORKS
from simgen.learning.evaluation.floor import Floor
from simgen.learning.training.evaluate import evaluate
from simgen.learning.training.run import TrainingRun
from tests.learning import touched

EARLY = {name: settings | {"epochs": 5, "patience": 1} for name, settings in touched.FITS.items()}


def with_other(dataset: Dataset, split: str, path: Path) -> Dataset:
    """A copy in which all presses of a split have moved otherwise: half as far, and 30 um aside."""
    changed = Dataset(shutil.copytree(dataset.path, path))
    presses = np.flatnonzero(dataset["press/split"] == list(SPLITS).index(split))
    for sensor in dataset.sensors:
        stored = dataset.stored_displacement(sensor, slice(None))
        moved = np.isin(np.arange(len(stored)), presses)[:, None] & (dataset[f"{sensor}/status"] == 0)
        stored[moved] = stored[moved] // 2 + 300
        fake.change(changed, f"{sensor}/displacement", slice(None), stored)
    return changed


def histories(output: Path) -> dict[str, list[list[str]]]:
    """Network -> lines of its epochs.csv, without the seconds: which epochs there were, and all their losses."""
    found = {}
    for name in NETWORKS:
        lines = [line.split(",") for line in (output / name / "epochs.csv").read_text().splitlines()]
        found[name] = [[cell for number, cell in enumerate(line) if number != 2] for line in lines]
    return found


@pytest.fixture(scope="module")
def as_it_is(with_electrodes, tmp_path_factory) -> TrainingRun:
    return touched.train(job(with_electrodes), tmp_path_factory.mktemp("as it is") / "networks")


@pytest.fixture(scope="module")
def output(as_it_is) -> Path:
    return as_it_is.output


def job(dataset: Dataset):
    return touched.job(dataset.path, **EARLY)


@pytest.fixture(scope="module")
def other_test(with_electrodes, tmp_path_factory) -> TrainingRun:
    """All trained where the test's presses have moved otherwise."""
    folder = tmp_path_factory.mktemp("other test")
    return touched.train(job(with_other(with_electrodes, "test", folder / "d.zarr")), folder / "networks")


def test_no_network_sees_the_test(output, other_test):
    assert touched.weights(output) == touched.weights(other_test.output)
    assert len(touched.weights(output)) == len(NETWORKS)


def test_the_test_does_not_decide_when_to_stop(output, other_test):
    found = histories(output)
    assert found == histories(other_test.output)
    assert any(len(lines) - 1 < 5 for lines in found.values())  # some did stop early


def test_the_test_is_what_is_measured(as_it_is, other_test):
    """What is compared above does differ: errors of the same networks change with the test."""
    before = evaluate(as_it_is, lambda items, about: items)
    after = evaluate(other_test, lambda items, about: items)
    own, changed = (
        {(entry.task, entry.model): entry.main_error for entry in entries if not isinstance(entry.errors, Floor)}
        for entries in (before, after)
    )
    assert own.keys() == changed.keys()
    assert all(changed[each] != value for each, value in own.items())
    assert all(np.array_equal(a.errors.rows, b.errors.rows) for a, b in zip(before, after, strict=True))


def test_validation_decides_which_epoch_is_kept_and_no_more(with_electrodes, output, tmp_path):
    """Networks that learn from no other network: the epochs that both have taught the same."""
    other = with_other(with_electrodes, "validation", tmp_path / "d.zarr")
    names = ["svb", "mvb", "mvd", "rmb", "rmd"]
    networks = touched.train(touched.job(other.path, **EARLY, networks=names), tmp_path / "networks").output
    for name in names:
        (header, *own), (_, *changed) = [
            [line.split(",") for line in (folder / name / "epochs.csv").read_text().splitlines()]
            for folder in (output, networks)
        ]
        taught, seen = header.index("train_loss"), header.index("validation_loss")
        pairs = list(zip(own, changed, strict=False))
        assert all(a[taught] == b[taught] and a[seen] != b[seen] for a, b in pairs) and len(pairs) >= 2


def test_every_network_sees_the_training(with_electrodes, output, tmp_path):
    """What the first test compares does change where it should."""
    other = with_other(with_electrodes, "train", tmp_path / "d.zarr")
    networks = touched.train(job(other), tmp_path / "networks").output
    own, changed = touched.weights(output), touched.weights(networks)
    assert all(own[name] != changed[name] for name in NETWORKS)


def test_no_trajectory_is_in_two_splits(trained):
    data, signals = trained.inputs.data, trained.inputs.signals
    for split_of in (data.split, signals.split):
        assert len(split_of) == len(data.trajectory) == len(data)
        splits = {trajectory: set(split_of[data.trajectory == trajectory]) for trajectory in range(12)}
        assert all(len(own) == 1 for own in splits.values())
        assert set.union(*splits.values()) == set(range(len(SPLITS)))
    rows = [set(signals.rows(split).tolist()) for split in SPLITS]
    assert sum(map(len, rows)) == len(set.union(*rows)) == len(data)
