"""A training job on disk: which networks there are, which come next, and from where a killed one goes on.

    <name>.networks/
      training.json                  the resolved job, the hash of the dataset's job, how many samples there are
      <network>/network.safetensors  the best epoch
      <network>/network.json         what it is, its job, dataset, code and packages; written last
      <network>/epochs.csv           a line per epoch
      <network>/state.safetensors    while it is trained: weights, moments, history
      table.md, metrics.json, metrics.csv, errors.png
"""

import csv
import io
import json
import platform
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import torch
from torch import nn

from simgen.config.warp_device import check_device_name
from simgen.dataset.atomic_files import whole_folder
from simgen.dataset.folder_lock import LockedError, locked
from simgen.dataset.provenance import code_version, difference, file_hash
from simgen.errors import InputError, writing
from simgen.learning.training.chain import ENDS
from simgen.learning.training.checkpoint import NETWORK, load_network, save_network
from simgen.learning.training.data import Track, load_training_data, mesh_hash
from simgen.learning.training.fit import Epoch, Training, epoch_seed
from simgen.learning.training.recipes import Inputs, make_recipe
from simgen.learning.training.schema import NETWORKS, TrainingJob
from simgen.learning.training.signals import recording_paths

RECORD, STATE, LOG = "training.json", "state.safetensors", "epochs.csv"
PACKAGES = ("torch", "numpy", "scipy", "safetensors")


class TrainingRun:
    """A checked job with its data on a device, and its folder.

    Raises `InputError` for a dataset or a device that is not there, for a folder that another job has begun, and for
    what a network would miss after hours: another network, samples of a split, meshes of the recordings.
    """

    def __init__(self, job: TrainingJob, output: Path, device: str, track: Track = lambda items, about: items):
        self.job, self.output, self.device = job, output, torch_device(device)
        if self.device.type == "cuda":
            torch.cuda.set_device(self.device)  # what is recorded as a graph runs on the current one
        self._check_needed()
        data = load_training_data(job.dataset_folder(), (job.source, job.target), self.device, track)
        record = {
            "job": job.resolved(),
            "job_hash": job.hash,
            "dataset": {"job_hash": data.dataset.attributes["job_hash"], "samples": len(data)},
            "recordings": _recordings(job),
        }
        if not _is_free(output):
            _check_begun(output, record)  # before signals are made, which may take minutes
        self.inputs = Inputs(job, data, cache(self.trained))
        self.inputs.check(job.networks)
        _claim(output, record)

    def trained(self, name: str) -> nn.Module:
        """A finished network. Raises `InputError` if there is none."""
        if not self.is_trained(name):
            raise InputError(f"{self.output}: {name} is needed and not trained yet; allowed: networks that list {name}")
        return load_network(self.output / name, self.device)

    def _check_needed(self) -> None:
        for name in self.job.in_order():
            for needed in filter(None, ENDS.get(name, ())):
                if needed not in self.job.networks and not self.is_trained(needed):
                    raise InputError(
                        f"networks: {name} needs {needed}, which {self.output} does not hold; allowed: to list both"
                    )

    def is_trained(self, name: str) -> bool:
        return is_trained(self.output, name)

    def trained_names(self) -> list[str]:
        return [name for name in NETWORKS if self.is_trained(name)]

    def train(self, name: str) -> Iterator[Epoch]:
        """Train a network to its end, epoch by epoch, from where it was stopped; nothing if it is trained.

        Raises `InputError` if another process is at it.
        """
        folder = self.output / name
        with writing(folder):
            folder.mkdir(exist_ok=True)
        try:
            with locked(folder):
                if not self.is_trained(name):
                    yield from self._train(name, folder)
                (folder / STATE).unlink(missing_ok=True)
        except LockedError as error:
            raise InputError(f"{folder}: is being trained by {error}") from None

    def _train(self, name: str, folder: Path) -> Iterator[Epoch]:
        torch.manual_seed(epoch_seed(self.job.seed, name, -1))  # of the weights
        recipe = make_recipe(name, self.inputs)
        network = recipe.network.to(self.device)
        training = Training(
            name, network, recipe.terms, recipe.rows, recipe.settings, self.job.seed, folder / STATE, recipe.coarse
        )
        for epoch in training:
            _write_log(folder / LOG, training.progress.history)
            yield epoch
        history, best = training.progress.history, training.progress.best
        _write_log(folder / LOG, history)  # once more: a kill may have come between the last state and its line
        seconds = sum(epoch.seconds for epoch in history)
        about = {
            "name": name,
            "epochs": len(history),
            "best_epoch": best,
            "best": history[best].terms,
            "seconds": round(seconds, 3),
            "samples_per_second": round(training.samples * len(history) / seconds, 1),
            "device": device_name(self.device),
            "job": self.job.resolved(),
            "dataset": {
                "job_hash": self.inputs.data.dataset.attributes["job_hash"],
                "meshes": {name: mesh_hash(each.tetrahedra) for name, each in self.inputs.data.meshes.items()},
                "samples": {"train": len(recipe.rows[0]), "validation": len(recipe.rows[1])},
            },
            "code": code_version(),
            "packages": {package: metadata.version(package) for package in PACKAGES},
        }
        save_network(folder / NETWORK, network, about)


def is_trained(output: Path, name: str) -> bool:
    """Whether a folder of networks holds one, whole."""
    return (output / name / NETWORK).with_suffix(".json").exists()


def torch_device(name: str) -> torch.device:
    """cpu or cuda:N, of which ``cuda`` is the first. Raises `InputError` unless this machine has it."""
    check_device_name(name)
    device = torch.device(name)
    if device.type != "cuda":
        return device
    number, count = device.index or 0, torch.cuda.device_count()
    if number >= count:
        gpus = ", ".join(f"cuda:{number}" for number in range(count)) or "no CUDA GPU"
        raise InputError(f"device {name!r}: torch sees {gpus}; allowed here: cpu{', cuda' * bool(count)}")
    return torch.device("cuda", number)  # `torch.cuda.set_device` takes none without a number


def device_name(device: torch.device) -> str:
    return torch.cuda.get_device_name(device) if device.type == "cuda" else platform.processor() or "cpu"


def _recordings(job: TrainingJob) -> dict[str, str]:
    """sha256 of each file. Raises `InputError`."""
    recordings = job.signals.recordings
    if recordings is None:
        return {}
    paths = recording_paths(recordings, job.folder)
    try:
        return {name: file_hash(path) for name, path in zip(recordings.files, paths, strict=True)}
    except OSError as error:
        raise InputError(f"{error.filename}: cannot be read: {error.strerror}") from None


def _claim(output: Path, record: dict[str, Any]) -> None:
    """Make the folder of a job, or check that it is this job's. Raises `InputError`."""
    if output.name and _is_free(output):  # nothing is put in the place of the current folder
        with writing(output):
            output.parent.mkdir(parents=True, exist_ok=True)
            with suppress(FileExistsError), whole_folder(output) as folder:  # another process may begin the same job
                (folder / RECORD).write_text(json.dumps(record, indent=1), encoding="utf-8")
    _check_begun(output, record)


def _is_free(output: Path) -> bool:
    return not output.exists() or (output.is_dir() and not any(output.iterdir()))


def _check_begun(output: Path, record: dict[str, Any]) -> None:
    file = output / RECORD
    if not file.exists():
        raise InputError(f"{output}: exists already and is no training; remove it, or choose another --output")
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
        changes = difference({key: found[key] for key in record}, record)
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"{file}: not what `simgen train` wrote ({error})") from None
    changes = [line for line in changes if not line.startswith("job_hash")]
    if changes:
        more = f" (and {len(changes) - 1} more)" if len(changes) > 1 else ""
        raise InputError(f"{output}: was begun with another job: {changes[0]}{more}; choose another --output")


def _write_log(file: Path, history: list[Epoch]) -> None:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(history[0].row()))
    writer.writeheader()
    writer.writerows(epoch.row() for epoch in history)
    with writing(file):
        file.write_text(text.getvalue(), encoding="utf-8")
