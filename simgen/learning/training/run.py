"""A training run and its folder on disk. A killed run continues with the same command.

    <name>.networks/
      training.json                  the resolved job, the hash of the dataset's job, how many samples there are
      <network>/network.safetensors  the best epoch
      <network>/network.json         kind, settings, job, dataset, code and packages; written last
      <network>/epochs.csv           a line for each epoch
      <network>/state.safetensors    only while it is trained: weights, moments, history
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

from simgen.config.strict_section import section_from_dict
from simgen.config.warp_device import check_device_name
from simgen.dataset.atomic_files import whole_folder
from simgen.dataset.folder_lock import LockedError, locked
from simgen.dataset.provenance import code_version, difference, file_hash
from simgen.errors import InputError, writing
from simgen.learning.data.registry import NETWORKS
from simgen.learning.data.samples import Track, load_training_data, mesh_hash
from simgen.learning.data.schema import TrainingJob
from simgen.learning.data.signals import recording_paths
from simgen.learning.networks.checkpoint import NETWORK, load_network, save_network
from simgen.learning.networks.network import Network, network_class
from simgen.learning.networks.network_data import NetworkData, TrainingInputs
from simgen.learning.training.fit import Epoch, Training, epoch_seed

RECORD, STATE, LOG = "training.json", "state.safetensors", "epochs.csv"
PACKAGES = ("torch", "numpy", "scipy", "safetensors")


class TrainingRun:
    """A checked job, its data on a device, and its folder.

    Raises `InputError` for a missing dataset or device, for a folder of another job, and for anything that would
    stop a network hours later: a missing network, no samples of a split, recordings without meshes.
    """

    def __init__(self, job: TrainingJob, output: Path, device: str, track: Track = lambda items, about: items):
        self.job, self.output, self.device = job, output, torch_device(device)
        if self.device.type == "cuda":
            torch.cuda.set_device(self.device)  # CUDA graphs run on the current device
        self._check_needed()
        sensors = job.source, job.target
        data = load_training_data(job.dataset_folder(), sensors, self.device, track, job.leave_out)
        record = {
            "job": job.resolved(),
            "job_hash": job.hash,
            "dataset": {"job_hash": data.dataset.attributes["job_hash"], "samples": len(data)},
            "recordings": _recordings(job),
        }
        if not _is_free(output):
            _check_begun(output, record)  # before signals are made, which may take minutes
        self.inputs = TrainingInputs(job, data, cache(self.trained))
        self.inputs.check(job.networks)
        _claim(output, record)

    def trained(self, name: str) -> Network:
        """Load a finished network. Raises `InputError` if there is none."""
        if not self.is_trained(name):
            raise InputError(f"{self.output}: {name} is needed and not trained yet; allowed: networks with {name}")
        return load_network(self.output / name, self.device)

    def _check_needed(self) -> None:
        for name in self.job.in_order():
            for needed in self.job.needs(name):
                if needed not in self.job.networks and not self.is_trained(needed):
                    spec = NETWORKS[name]
                    without = f", or {spec.settings}.predicted=0" if needed in spec.feeding else ""
                    raise InputError(
                        f"networks: {name} needs {needed}, which {self.output} does not hold; allowed: both{without}"
                    )

    def is_trained(self, name: str) -> bool:
        return is_trained(self.output, name)

    def trained_names(self) -> list[str]:
        return [name for name in NETWORKS if self.is_trained(name)]

    def train(self, name: str) -> Iterator[Epoch]:
        """Train a network and yield each epoch. Continues a stopped training; yields nothing for a trained network.

        Raises `InputError` if another process trains it.
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
        torch.manual_seed(epoch_seed(self.job.seed, name, -1))  # decides the weights; loading networks draws, too
        data = NetworkData(NETWORKS[name], self.inputs)
        network, terms = network_class(NETWORKS[name]).for_training(data)
        network = network.to(self.device)
        rows = data.train, data.validation
        training = Training(name, network, terms, rows, data.settings, self.job.seed, folder / STATE, network.tf32)
        for epoch in training:
            _write_log(folder / LOG, training.progress.history)
            yield epoch
        history, best = training.progress.history, training.progress.best
        _write_log(folder / LOG, history)  # a kill may have come between the last state and its line
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
                "samples": {"train": len(data.train), "validation": len(data.validation)},
            },
            "code": code_version(),
            "packages": {package: metadata.version(package) for package in PACKAGES},
        }
        network.finish(data)
        save_network(folder / NETWORK, network, about)


def is_trained(output: Path, name: str) -> bool:
    """Return True if a folder of networks holds this one, complete."""
    return (output / name / NETWORK).with_suffix(".json").exists()


def torch_device(name: str) -> torch.device:
    """Find a device: "cpu", "cuda" (the first GPU) or "cuda:N". Raises `InputError` if this machine lacks it."""
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
    """Hash each recording: name -> sha256. Raises `InputError`."""
    recordings = job.signals.recordings
    if recordings is None:
        return {}
    paths = recording_paths(recordings, job.folder)
    try:
        return {name: file_hash(path) for name, path in zip(recordings.files, paths, strict=True)}
    except OSError as error:
        raise InputError(f"{error.filename}: cannot be read: {error.strerror}") from None


def _claim(output: Path, record: dict[str, Any]) -> None:
    """Make the folder of a job, or check that it belongs to this job. Raises `InputError`."""
    if output.name and _is_free(output):  # the current folder has no name: it is never replaced
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
        found["job"] = section_from_dict(TrainingJob, found["job"] | {"dataset": "unknown"}, str(file)).resolved()
        changes = difference({key: found[key] for key in record}, record)
    except (OSError, ValueError, KeyError, TypeError, RecursionError, InputError) as error:
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
