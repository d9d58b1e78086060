"""A training as a user has it: it goes on after a kill, keeps other jobs out, and says what trained a network."""

import csv
import hashlib
import json
import shutil
import signal
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import fake
import pytest
import torch
import yaml

import simgen
from simgen.dataset import Dataset
from simgen.errors import InputError
from simgen.folder_lock import held
from simgen.splits import IN_NONE, SPLITS
from simgen.training.run import STATE, TrainingRun, torch_device
from simgen.training.schema import NETWORKS

from . import touched

# The command line, but that a state is saved after each epoch, and that a signal comes in the middle of the third.
CHILD = """
import os, signal
from simgen.cli import main
from simgen.training import fit
from simgen.training.step import Step

step, steps = Step._step, []

def stopped(self):
    step(self)
    steps.append(1)
    if len(steps) == {steps}:
        os.kill(os.getpid(), signal.{signal})

Step._step = stopped
fit.SAVE_EVERY_S = 0.0
main()
"""
STEPS_AN_EPOCH = 2  # of 90 training samples, 32 a step
JOB = {"networks": ["mvd"], "mesh_vae": {"epochs": 4, "batch": 32, "latent": 3}}


def start(folder: Path, dataset: Path, ending: str) -> subprocess.CompletedProcess:
    """`simgen train`, which gets a signal in the middle of its third epoch; networks go to ``folder / networks``."""
    job = {"name": "tiny", "seed": 1, "dataset": str(dataset), **touched.FITS} | JOB
    (folder / "job.yaml").write_text(yaml.safe_dump(job))
    code = CHILD.format(signal=ending, steps=2 * STEPS_AN_EPOCH + 1)
    command = [sys.executable, "-c", code, "train", "job.yaml", "--output", "networks"]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120)


def epochs(folder: Path) -> list[dict[str, str]]:
    """Lines of epochs.csv, without the time they took."""
    with open(folder / "epochs.csv", newline="") as file:
        return [{key: value for key, value in line.items() if key != "seconds"} for line in csv.DictReader(file)]


@pytest.fixture(scope="module")
def undisturbed(with_electrodes, tmp_path_factory) -> Path:
    output = tmp_path_factory.mktemp("undisturbed") / "networks"
    touched.train(touched.job(with_electrodes.path, **JOB), output)
    return output


@pytest.mark.parametrize(("ending", "code"), [("SIGKILL", -signal.SIGKILL), ("SIGINT", 130)])
def test_what_is_stopped_in_an_epoch_goes_on_to_the_same_bytes(with_electrodes, undisturbed, tmp_path, ending, code):
    done = start(tmp_path, with_electrodes.path, ending)
    output = tmp_path / "networks"
    assert done.returncode == code, done.stderr
    assert not done.stderr
    assert (ending == "SIGINT") == ("stopped; the same command goes on from networks" in done.stdout)
    assert (output / "mvd" / STATE).exists() and not touched.weights(output)
    assert epochs(output / "mvd") == epochs(undisturbed / "mvd")[:2]

    run = TrainingRun(touched.job(with_electrodes.path, **JOB), output, "cpu")
    assert [epoch.number for epoch in run.train("mvd")] == [2, 3]
    assert touched.weights(output) == touched.weights(undisturbed)
    assert epochs(output / "mvd") == epochs(undisturbed / "mvd")
    assert not (output / "mvd" / STATE).exists()


def test_what_is_trained_is_not_trained_again(trained):
    before = {file: file.stat().st_mtime_ns for file in trained.output.rglob("*.safetensors")}
    again = TrainingRun(trained.job, trained.output, "cpu")
    assert again.trained_names() == list(NETWORKS)
    assert [list(again.train(name)) for name in NETWORKS] == [[]] * len(NETWORKS)
    assert {file: file.stat().st_mtime_ns for file in trained.output.rglob("*.safetensors")} == before


def test_networks_do_not_depend_on_what_was_trained_beside_them(trained, with_electrodes, tmp_path):
    touched.train(touched.job(with_electrodes.path, networks=["mvd"]), tmp_path / "alone")
    assert touched.weights(tmp_path / "alone") == {"mvd": touched.weights(trained.output)["mvd"]}


def test_another_seed_is_another_network(trained, with_electrodes, tmp_path):
    touched.train(touched.job(with_electrodes.path, networks=["mvd"], seed=2), tmp_path / "other")
    assert touched.weights(tmp_path / "other")["mvd"] != touched.weights(trained.output)["mvd"]


def test_the_sidecar_says_what_trained_it(trained):
    for name in NETWORKS:
        about = json.loads((trained.output / name / "network.json").read_text())
        history = epochs(trained.output / name)
        losses = [float(line["validation_loss"]) for line in history]
        assert about["name"] == name and about["device"] and about["packages"]["torch"] == metadata.version("torch")
        assert about["job"] == trained.job.resolved() and about["code"]
        assert about["epochs"] == len(history) == trained.job.fit_of(name).epochs
        assert about["best_epoch"] == losses.index(min(losses))
        assert about["best"]["validation_loss"] == min(losses)
        assert about["dataset"]["job_hash"] == trained.inputs.data.dataset.attributes["job_hash"]
        rows = {split: len(trained.inputs.data.rows(split)) for split in ("train", "validation")}
        assert about["dataset"]["samples"] == rows
        weights = (trained.output / name / "network.safetensors").read_bytes()
        assert about["sha256"] == hashlib.sha256(weights).hexdigest()


@pytest.mark.parametrize("name", NETWORKS)
def test_one_line_gives_a_network_back(trained, name):
    network = simgen.load_network(trained.output / name)
    assert not network.training
    stored = simgen.training.checkpoint.safetensors.torch.load_file(trained.output / name / "network.safetensors")
    assert network.state_dict().keys() == stored.keys()
    assert all(torch.equal(value, stored[key]) for key, value in network.state_dict().items())


def test_what_is_kept_is_the_best_epoch(trained):
    """Its validation loss, computed anew of what is on disk, is the least of the history."""
    svb, signals = trained.trained("svb"), trained.inputs.signals
    with torch.no_grad():
        found = svb.terms(signals.values[signals.rows("validation")], trained.job.signal_vae.beta)["loss"].item()
    best = min(float(line["validation_loss"]) for line in epochs(trained.output / "svb"))
    assert found == pytest.approx(best, rel=1e-6)  # sums of float32 in one batch or another


def test_a_folder_of_another_job_is_one_line(trained, with_electrodes):
    other = touched.job(with_electrodes.path, mesh_vae={**touched.FITS["mesh_vae"], "beta": 0.25})
    with pytest.raises(InputError, match=r"was begun with another job: job.mesh_vae.beta: 0.005 -> 0.25; choose"):
        TrainingRun(other, trained.output, "cpu")


def test_a_folder_of_another_dataset_is_one_line(trained, tmp_path):
    other = touched.make(tmp_path / "other.zarr", seed=4)
    with pytest.raises(InputError, match=r"was begun with another job: dataset.job_hash: "):
        TrainingRun(touched.job(other.path), trained.output, "cpu")


def test_a_dataset_may_move_and_more_networks_may_come(trained, with_electrodes, tmp_path):
    (tmp_path / "link.zarr").symlink_to(with_electrodes.path)
    job = touched.job(tmp_path / "link.zarr", networks=["mvd"])
    assert TrainingRun(job, trained.output, "cpu").is_trained("mvb")


@pytest.mark.parametrize(("name", "needed"), [("s2mpn", "svb"), ("m2mpn", "mvb"), ("s2rm", "rmb"), ("rm2rm", "rmb")])
def test_a_network_that_is_needed_is_missed_before_anything_is_trained(with_electrodes, tmp_path, name, needed):
    job = touched.job(with_electrodes.path, networks=["mvd", name])
    with pytest.raises(InputError, match=f"networks: {name} needs {needed}, which .*networks does not hold"):
        TrainingRun(job, tmp_path / "networks", "cpu")
    assert not list(tmp_path.iterdir())


def test_a_network_that_is_needed_and_gone_is_one_line(with_electrodes, tmp_path):
    run = TrainingRun(touched.job(with_electrodes.path, networks=["rmb", "rmd", "rm2rm"]), tmp_path / "networks", "cpu")
    with pytest.raises(InputError, match="networks: rmb is needed and not trained yet; allowed: networks that list"):
        next(run.train("rm2rm"))


@pytest.mark.parametrize("split", list(SPLITS))
def test_a_split_without_samples_is_missed_before_anything_is_trained(with_electrodes, tmp_path, split):
    few = Dataset(shutil.copytree(with_electrodes.path, tmp_path / "few.zarr"))
    split_of = few["press/split"]
    fake.change(few, "press/split", split_of == list(SPLITS).index(split), IN_NONE)
    with pytest.raises(InputError, match=f"few.zarr: no sample of split {split}; samples: "):
        TrainingRun(touched.job(few.path, networks=["mvd"]), tmp_path / "networks", "cpu")
    assert not (tmp_path / "networks").exists()


def test_two_processes_do_not_train_one_network(with_electrodes, tmp_path):
    run = TrainingRun(touched.job(with_electrodes.path, networks=["mvd"]), tmp_path / "networks", "cpu")
    (run.output / "mvd").mkdir()
    with held(run.output / "mvd"), pytest.raises(InputError, match="mvd: is being trained by process"):
        next(run.train("mvd"))
    assert len(list(run.train("mvd"))) == touched.FITS["mesh_vae"]["epochs"]


def test_an_empty_folder_is_taken(with_electrodes, tmp_path):
    run = TrainingRun(touched.job(with_electrodes.path, networks=["mvd"]), tmp_path, "cpu")
    assert (run.output / "training.json").exists()


def test_the_current_folder_is_no_training(with_electrodes, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="exists already and is no training"):
        TrainingRun(touched.job(with_electrodes.path, networks=["mvd"]), Path(), "cpu")


def test_a_device_that_is_not_there_is_one_line():
    count = torch.cuda.device_count()
    with pytest.raises(InputError, match=rf"device 'cuda:{count}': torch sees .*; allowed here: cpu"):
        torch_device(f"cuda:{count}")
    with pytest.raises(InputError, match="device 'gpu' is not allowed"):
        torch_device("gpu")
