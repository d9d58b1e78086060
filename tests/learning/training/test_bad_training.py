"""Bad input of `simgen train`: one line that says where, what and what is allowed, exit code 2, and nothing is lost.

A row is what is wrong, keys of the job, the command line behind `simgen train`, and words of the line.
"""

import json
import shutil
from pathlib import Path

import fake
import pytest
import torch
import yaml
from refusal import check_refusal, contents, rows, simgen

from simgen.cli import train as view
from simgen.learning.networks.checkpoint import read_state, write_state
from simgen.learning.training import fit
from simgen.learning.training.run import TrainingRun
from simgen.pipeline.run import run
from tests.learning import touched

JOB = "job.yaml"
MVD = f"{JOB} networks=[mvd]"
ROWS = [
    ("unknown key", {"colour": "red"}, JOB, "job.yaml: colour: unknown key; allowed: name, seed, dataset"),
    ("a key of another section", {"mesh_vae": {"widths": [8]}}, JOB, "mesh_vae.widths: unknown key; allowed: epochs"),
    ("a slip", {"mesh_vae": {"epoch": 8}}, JOB, "mesh_vae.epoch: unknown key; "),
    ("wrong type", {"seed": "one"}, JOB, 'seed: "one" is not allowed; allowed: a whole number'),
    ("text for a number", {"mesh_vae": {"learning_rate": "fast"}}, JOB, 'learning_rate: "fast" is not allowed'),
    ("no number", {"mesh_vae": {"beta": float("nan")}}, JOB, "mesh_vae.beta: NaN is not allowed"),
    ("text for a list", {"networks": "mvb"}, JOB, 'networks: "mvb" is not allowed; allowed: a list of svb, mvb'),
    ("unknown network", {"networks": ["gan"]}, JOB, 'networks.0: "gan" is not allowed; allowed: a list of svb, mvb'),
    ("no network", {"networks": []}, JOB, "networks: [] is not allowed; allowed: a list of svb, mvb"),
    ("no epoch", {}, f"{JOB} mesh_vae.epochs=0", "override mesh_vae.epochs=0: mesh_vae.epochs: 0 is not allowed"),
    ("one dropout too few", {"mesh_projection": {"dropout": [0.1]}}, JOB, "mesh_projection: 1 dropout, 4 widths; "),
    ("all dropped", {"mesh_projection": {"widths": [4], "dropout": [1.0]}}, JOB, "dropout.0: 1.0 is not allowed"),
    ("no dataset named", {"dataset": None}, JOB, "job.yaml: dataset: "),
    ("dataset missing", {"dataset": "gone.zarr"}, JOB, "gone.zarr: not a dataset"),
    ("a dataset that is none", {"dataset": "."}, JOB, ".: not a dataset"),
    ("unknown sensor", {"source": "finger"}, JOB, "d.zarr: sensor 'finger': allowed: digit, biotac"),
    ("one sensor twice", {"source": "digit"}, JOB, "source and target are both 'digit'; allowed: two sensors"),
    ("a source without electrodes", {"source": "digit", "target": "biotac"}, JOB, "its model has no electrodes"),
    ("dataset of one sensor", {"dataset": "one.zarr"}, JOB, "one.zarr: sensor 'biotac': allowed: digit"),
    ("too few trajectories", {"dataset": "few.zarr", "networks": ["mvd"]}, JOB,
     "few.zarr: no sample of split test; samples: train 12"),
    ("what is needed", {"networks": ["mvd", "m2mpn"]}, JOB, "networks: m2mpn needs mvb, which tiny.networks does not"),
    ("what feeds", {"networks": ["rmb", "pt"]}, JOB,
     "networks: pt needs s2rm, which tiny.networks does not hold; allowed: both, or point_translation.predicted=0"),
    ("more members than samples", {"point_translation": {"members": 9, "batch": 8}}, JOB,
     "point_translation: 9 members, a batch of 8; allowed: a sample for each member"),
    ("recordings gone", {"signals": {"recordings": {"files": ["gone.h5"]}}}, JOB, "gone.h5: cannot be read: No such"),
    ("recordings of no file", {"signals": {"recordings": {"files": []}}}, JOB, "files: [] is not allowed; allowed: a"),
    ("a GPU that is not there", {}, f"{JOB} --device cuda:99", "device 'cuda:99': torch sees "),
    ("no device", {}, f"{JOB} --device gpu", "device 'gpu' is not allowed; allowed: cpu, cuda, cuda:N"),
    ("output a file", {}, f"{MVD} --output file", "file: exists already and is no training; remove it, or"),
    ("output below a file", {}, f"{MVD} --output file/deep", "file/deep: cannot be written: "),
    ("output another folder", {}, f"{MVD} --output full", "full: exists already and is no training; remove it, or"),
    ("output here", {}, f"{MVD} --output .", ".: exists already and is no training; remove it, or choose another"),
    ("no job", {}, "gone.yaml", "gone.yaml: no such training job file; bundled training jobs: training.yaml"),
    ("a job of a simulation", {}, "smoke", "smoke: no such training job file; bundled training jobs: training.yaml"),
]  # fmt: skip


@pytest.fixture(scope="module")
def others(tmp_path_factory) -> Path:
    """Datasets on which nothing can be trained."""
    folder = tmp_path_factory.mktemp("others")
    one = fake.make_job(sensors={"digit": {"model": "digit"}}, trajectories={"count": 2})
    run(fake.make_plan(one), folder / "one.zarr", build=fake.fake_presser)
    few = fake.make_job(trajectories={"count": 4}, indenters=["sphere_7mm"])
    run(fake.make_plan(few), folder / "few.zarr", build=fake.fake_presser)
    return folder


@pytest.fixture
def folder(tmp_path, monkeypatch, with_electrodes, others) -> Path:
    """The current folder, with datasets, a file, and a folder with a file."""
    monkeypatch.chdir(tmp_path)
    for dataset in (with_electrodes.path, *others.iterdir()):
        (tmp_path / dataset.name).symlink_to(dataset)
    (tmp_path / "file").write_text("anything")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").write_text("anything")
    write(tmp_path)
    return tmp_path


def write(folder: Path, **changes) -> None:
    job = {"name": "tiny", "seed": 1, "dataset": "d.zarr", **touched.FITS} | changes
    (folder / JOB).write_text(yaml.safe_dump(job))


def refused(command: str, words: str, monkeypatch, capfd) -> None:
    check_refusal(*simgen(f"train {command}", monkeypatch, capfd), words)


@pytest.mark.parametrize("changes, command, words", rows(ROWS))
def test_bad_input_is_one_line_and_writes_nothing(folder, monkeypatch, capfd, changes, command, words):
    write(folder, **changes)
    before = contents(folder)
    refused(command, words, monkeypatch, capfd)
    assert contents(folder) == before


def test_a_loss_without_a_number_is_one_line(folder, monkeypatch, capfd):
    """Of a rate at which training diverges."""
    write(folder, networks=["mvd"], mesh_vae=touched.FITS["mesh_vae"] | {"learning_rate": 1.0, "batch": 16})
    refused(JOB, "mvd: train_loss is nan in epoch 0; a smaller learning_rate may help", monkeypatch, capfd)
    assert not list(folder.rglob("network.*"))


def test_too_little_memory_is_one_line(folder, monkeypatch, capfd):
    def full(*arguments):
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB")

    monkeypatch.setattr(view, "evaluate", full)
    write(folder, networks=["mvd"])
    refused(JOB, "cpu: too little memory for this job; allowed: a smaller batch", monkeypatch, capfd)


def test_tensorboard_that_is_not_installed_is_one_line(folder, monkeypatch, capfd):
    monkeypatch.setitem(__import__("sys").modules, "torch.utils.tensorboard", None)
    write(folder, networks=["mvd"])
    refused(f"{JOB} --tensorboard", "--tensorboard: tensorboard is not installed; allowed: pip", monkeypatch, capfd)


def copy_of(output: Path, folder: Path) -> None:
    """One of the networks of a training, as if it had been trained here."""
    shutil.copytree(output / "mvd", folder / "tiny.networks" / "mvd")
    shutil.copy(output / "training.json", folder / "tiny.networks")


def half(file: Path) -> None:
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def sidecar(**changes):
    """A network whose sidecar says something else; None leaves a key out."""

    def change(file: Path) -> None:
        about = json.loads(file.read_text()) | changes
        file.write_text(json.dumps({key: value for key, value in about.items() if value is not None}))

    return change


@pytest.mark.parametrize(
    ("file", "change", "words"),
    [
        ("mvd/network.safetensors", half, "network.safetensors: not the weights that tiny.networks/mvd/network.json"),
        ("mvd/network.safetensors", Path.unlink, "mvd/network.safetensors: cannot be read: No such file"),
        ("mvd/network.json", half, "mvd/network.json: not what `simgen train` wrote ("),
        ("mvd/network.json", sidecar(best=None), "mvd/network.json: not what `simgen train` wrote ('best')"),
        ("mvd/network.json", sidecar(seconds="long"), "mvd/network.json: not what `simgen train` wrote ("),
        ("mvd/network.json", sidecar(kind="gan"), "mvd/network.safetensors: not a network of this version ("),
        ("mvd/network.json", sidecar(settings={"latent": 9}), "network.safetensors: not a network of this version ("),
        ("training.json", half, "training.json: not what `simgen train` wrote ("),
        ("training.json", lambda file: file.write_text("[]"), "training.json: not what `simgen train` wrote ("),
        ("training.json", lambda file: file.write_bytes(b"\xff"), "training.json: not what `simgen train` wrote ("),
        ("training.json", Path.unlink, "tiny.networks: exists already and is no training; remove it, or choose"),
    ],
)
def test_files_that_are_damaged_are_one_line_and_stay(folder, trained, monkeypatch, capfd, file, change, words):
    copy_of(trained.output, folder)
    change(folder / "tiny.networks" / file)
    before = contents(folder)
    refused(MVD, words, monkeypatch, capfd)
    assert contents(folder) == before


def test_a_folder_of_another_job_is_one_line_with_the_key(folder, trained, monkeypatch, capfd):
    copy_of(trained.output, folder)
    before = contents(folder)
    words = "tiny.networks: was begun with another job: job.mesh_vae.beta: 0.005 -> 0.5; choose another --output"
    refused(f"{MVD} mesh_vae.beta=0.5", words, monkeypatch, capfd)
    assert contents(folder) == before


@pytest.fixture(scope="module")
def begun(with_electrodes, tmp_path_factory) -> Path:
    """A training that was left after its first epoch."""
    output = tmp_path_factory.mktemp("begun") / "networks"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fit, "SAVE_EVERY_S", 0.0)
        next(epochs := TrainingRun(touched.job(with_electrodes.path, networks=["mvd"]), output, "cpu").train("mvd"))
        epochs.close()
    return output


def state(changed):
    """A state whose tensors and whose words are changed by a function of both."""

    def change(file: Path) -> None:
        write_state(file, *changed(*read_state(file)))

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (half, "state.safetensors: not a state of `simgen train` ("),
        (lambda file: file.write_bytes(b""), "state.safetensors: not a state of `simgen train` ("),
        (lambda file: file.write_bytes(b"nothing" * 99), "state.safetensors: not a state of `simgen train` ("),
        (state(lambda tensors, about: ({}, about)), "state.safetensors: not a state of this training (Error(s) in"),
        (state(lambda tensors, about: (tensors | {"a.b": torch.ones(1)}, about)), "of this training ('a'); remove it"),
        (state(lambda tensors, about: ({k: v[..., None] for k, v in tensors.items()}, about)), "(Error(s) in loading"),
        (state(lambda tensors, about: (tensors, {})), "state.safetensors: not a state of this training ('history')"),
        (state(lambda tensors, about: (tensors, [])), "state.safetensors: not a state of this training (list indices"),
        (state(lambda tensors, about: (tensors, about | {"history": [{}]})), "not a state of this training (Epoch"),
        (state(lambda tensors, about: (tensors, about | {"best": 7})), "not a state of this training (list index out"),
    ],
)
def test_states_that_are_damaged_are_one_line_and_stay(folder, begun, monkeypatch, capfd, change, words):
    copy_of(begun, folder)
    change(folder / "tiny.networks/mvd/state.safetensors")
    before = {file: data for file, data in contents(folder).items() if not file.endswith(".lock")}
    refused(MVD, words, monkeypatch, capfd)
    assert {file: data for file, data in contents(folder).items() if not file.endswith(".lock")} == before
