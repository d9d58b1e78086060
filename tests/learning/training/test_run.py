"""A training as a user has it: it goes on after a kill, keeps other jobs out, and says what trained a network."""

import csv
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import fake
import pytest
import refusal
import safetensors.torch
import torch
import yaml

import simgen
from simgen.dataset.folder_lock import locked
from simgen.dataset.reader import Dataset
from simgen.dataset.splits import IN_NONE, SPLITS
from simgen.errors import InputError
from simgen.learning.data.registry import NETWORKS
from simgen.learning.training import fit
from simgen.learning.training import run as runs
from simgen.learning.training.run import RECORD, STATE, TrainingRun, torch_device
from simgen.learning.training.step import TrainingStep
from tests.learning import touched

STEPS_AN_EPOCH = 2  # of 90 training samples, 32 a step
JOB = {"networks": ["mvd"], "mesh_vae": {"epochs": 4, "batch": 32, "latent": 3}}
COMMAND = "train job.yaml --output networks"


def stop_in_the_third_epoch(ending: signal.Signals, patch: pytest.MonkeyPatch) -> None:
    """From now on a state is saved after each epoch, and this process gets a signal in the middle of the third."""
    step, steps = TrainingStep._step, []

    def stopped(self):
        step(self)
        steps.append(1)
        if len(steps) == 2 * STEPS_AN_EPOCH + 1:
            os.kill(os.getpid(), ending)

    patch.setattr(TrainingStep, "_step", stopped)
    patch.setattr(fit, "SAVE_EVERY_S", 0.0)


def write_job(folder: Path, dataset: Path) -> None:
    job = {"name": "tiny", "seed": 1, "dataset": str(dataset), **touched.FITS} | JOB
    (folder / "job.yaml").write_text(yaml.safe_dump(job))


def epochs(folder: Path) -> list[dict[str, str]]:
    """Lines of epochs.csv, without the time they took."""
    with open(folder / "epochs.csv", newline="") as file:
        return [{key: value for key, value in line.items() if key != "seconds"} for line in csv.DictReader(file)]


@pytest.fixture(scope="module")
def undisturbed(with_electrodes, tmp_path_factory) -> Path:
    output = tmp_path_factory.mktemp("undisturbed") / "networks"
    touched.train(touched.job(with_electrodes.path, **JOB), output)
    return output


def check_it_goes_on(dataset: Path, folder: Path, undisturbed: Path) -> None:
    """What was stopped in its third epoch ends with the bytes of what was not."""
    output = folder / "networks"
    assert (output / "mvd" / STATE).exists() and not touched.weights(output)
    assert epochs(output / "mvd") == epochs(undisturbed / "mvd")[:2]
    run = TrainingRun(touched.job(dataset, **JOB), output, "cpu")
    assert [epoch.number for epoch in run.train("mvd")] == [2, 3]
    assert touched.weights(output) == touched.weights(undisturbed)
    assert epochs(output / "mvd") == epochs(undisturbed / "mvd")
    assert not (output / "mvd" / STATE).exists()


def test_kill_9_in_an_epoch_and_a_second_run_give_the_same_bytes(with_electrodes, undisturbed, tmp_path):
    write_job(tmp_path, with_electrodes.path)
    code = (
        "import signal, pytest; from simgen.cli.app import main; from learning.training import test_run; "
        "test_run.stop_in_the_third_epoch(signal.SIGKILL, pytest.MonkeyPatch()); main()"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-c", code, *COMMAND.split()]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stderr) == (-signal.SIGKILL, "")
    check_it_goes_on(with_electrodes.path, tmp_path, undisturbed)


def test_an_interrupt_ends_with_130_and_the_same_command_goes_on(
    with_electrodes, undisturbed, tmp_path, monkeypatch, capfd
):
    monkeypatch.chdir(tmp_path)
    write_job(tmp_path, with_electrodes.path)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell starts others that ignore it
    try:
        with monkeypatch.context() as patch:
            stop_in_the_third_epoch(signal.SIGINT, patch)
            code, output, errors = refusal.simgen(COMMAND, patch, capfd)
    finally:
        signal.signal(signal.SIGINT, before)
    assert (code, errors) == (130, "")
    assert "stopped; the same command continues from networks" in output
    check_it_goes_on(with_electrodes.path, tmp_path, undisturbed)


def test_a_kill_before_the_last_line_of_the_log_leaves_a_whole_log(with_electrodes, undisturbed, tmp_path, monkeypatch):
    """The state of the last epoch is on disk by then, and nothing is left to train."""
    training, write = touched.job(with_electrodes.path, **JOB), runs._write_log

    def killed(file, history):
        if len(history) == JOB["mesh_vae"]["epochs"]:
            raise KeyboardInterrupt
        write(file, history)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(runs, "_write_log", killed)
        touched.train(training, tmp_path / "networks")
    touched.train(training, tmp_path / "networks")
    assert epochs(tmp_path / "networks" / "mvd") == epochs(undisturbed / "mvd")


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
    stored = safetensors.torch.load_file(trained.output / name / "network.safetensors")
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


@pytest.mark.parametrize(("key", "value"), [("job_hash", "0" * 64), ("samples", 121)])
def test_a_folder_of_another_dataset_is_one_line(trained, tmp_path, key, value):
    record = json.loads((trained.output / "training.json").read_text())
    record["dataset"][key] = value
    (tmp_path / "training.json").write_text(json.dumps(record))
    with pytest.raises(InputError, match=f"was begun with another job: dataset.{key}: {value} -> "):
        TrainingRun(trained.job, tmp_path, "cpu")


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
    with pytest.raises(InputError, match="networks: rmb is needed and not trained yet; allowed: networks with rmb"):
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
    with locked(run.output / "mvd"), pytest.raises(InputError, match="mvd: is being trained by process"):
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


def test_a_gpu_has_a_number_that_it_can_be_chosen_by(monkeypatch):
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    chosen = []
    monkeypatch.setattr(torch._C, "_cuda_setDevice", chosen.append, raising=False)
    for name in ("cuda", "cuda:0", "cuda:1"):
        torch.cuda.set_device(torch_device(name))
    assert chosen == [0, 0, 1]
    assert torch_device("cpu") == torch.device("cpu")


def test_a_folder_of_an_older_version_goes_on(with_electrodes, tmp_path):
    """Its record lacks keys that a later version has; their defaults count."""
    job = touched.job(with_electrodes.path, networks=["rmb"])
    touched.train(job, tmp_path / "older")
    record = json.loads((tmp_path / "older" / RECORD).read_text())
    del record["job"]["leave_out"], record["job"]["reduced_model"]["clip"]
    (tmp_path / "older" / RECORD).write_text(json.dumps(record))
    assert TrainingRun(job, tmp_path / "older", "cpu").trained_names() == ["rmb"]
    with pytest.raises(InputError, match=r"was begun with another job: job\.leave_out"):
        TrainingRun(touched.job(with_electrodes.path, leave_out="ring_7mm"), tmp_path / "older", "cpu")


def test_a_source_without_electrodes_trains_from_true_meshes(with_electrodes, tmp_path):
    """PT alone, with no predicted inputs: signals are never made."""
    point = touched.FITS["point_translation"] | {"predicted": 0.0, "epochs": 1}
    run = touched.train(touched.job(with_electrodes.path, networks=["pt"], point_translation=point), tmp_path / "alone")
    assert run.trained_names() == ["pt"] and "signals" not in run.inputs.__dict__
