"""Electrode signals for training: synthetic ones of a dataset's samples, or recordings with their own split."""

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from simgen.dataset.splits import SPLITS, split_by_trajectory
from simgen.errors import InputError
from simgen.learning.data.registry import SIGNALS, SOURCE, chains
from simgen.learning.data.samples import BATCH, MeshSamples, TrainingData
from simgen.learning.data.schema import RecordingFiles, Signals
from simgen.sensing.electrodes.gaps import checked_gaps, gauge_of
from simgen.sensing.electrodes.model import measured, voltage
from simgen.sensing.electrodes.recordings import Recordings, read_recordings
from simgen.sensing.electrodes.signals import Scaling, in_contact, without_drift

LEAST_PRESSED = 0.01  # share of a recording's samples, those with the least force, that stands for rest
BLOCKS = 100  # of time, of a recording: neighbouring samples look alike, so each block is in one split


@dataclass(frozen=True)
class SignalData:
    """Electrode signals, and meshes of the same samples if they are known."""

    values: Tensor  # (sample, channel) float32, V or as recorded
    split: np.ndarray  # (sample,) index into SPLITS, or -1
    meshes: MeshSamples | None
    rest: Tensor  # (channel,) without contact

    def rows(self, split: str) -> Tensor:
        """Row numbers (n,) of a split, on the device of the values. Raises `InputError` if there are none."""
        rows = np.flatnonzero(self.split == list(SPLITS).index(split))
        if not len(rows):
            count = len(self.split)
            raise InputError(f"signals: no sample of split {split}, {count} in all; allowed: some in each split")
        return torch.from_numpy(rows).to(self.values.device)

    def with_meshes(self) -> MeshSamples:
        """Meshes of the samples. Raises `InputError` if there are none."""
        if self.meshes is None:
            names = " and ".join(names[0] for names in chains(SIGNALS, SOURCE))
            raise InputError(
                f"signals.recordings: not all files hold meshes (nodal_res), which {names} need; allowed: files that "
                "do, or networks without these"
            )
        return self.meshes

    def bounds(self) -> tuple[Tensor, Tensor]:
        """Least and largest value of each channel in training, (channel,) float64 each, on the CPU."""
        scaling = Scaling.fit(self.values[self.rows("train")].double().cpu().numpy())
        return torch.tensor(scaling.low), torch.tensor(scaling.high)

    def normalised(self, values: Tensor) -> Tensor:
        """Signals (n, channel), each channel from -1 to 1 within its range in training."""
        return normalised(values, *(bound.float().to(values.device) for bound in self.bounds()))


def normalised(values: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Values (n, channel), from -1 to 1 between ``low`` and ``high`` (channel,); 0 where both are equal."""
    span = high - low
    return torch.where(span > 0, (2.0 * values - low - high) / span.where(span > 0, 1.0), 0.0)


def read_signals(data: TrainingData, sensor: str, settings: Signals, folder: Path, seed: int) -> SignalData:
    """Read the recordings of a job, or make synthetic signals. Raises `InputError`."""
    if settings.recordings is not None:
        return recorded(settings.recordings, folder, seed, data.meshes[sensor])
    return synthetic(data, sensor, settings)


def synthetic(data: TrainingData, sensor: str, settings: Signals) -> SignalData:
    """Make signals of every sample of a dataset by the electrode model, with the dataset's splits.

    They are those of `simgen.sensing.electrodes.model.synthetic_signals`, from the meshes that are already here.
    """
    dataset, meshes, circuit = data.dataset, data.meshes[sensor], settings.synthetic
    device = meshes.steps.device
    gauge = gauge_of(dataset, sensor, str(device))
    inner, batches = torch.from_numpy(gauge.used).to(device), torch.arange(len(data), device=device).split(BATCH)
    moved = (meshes.scale * meshes.steps[rows].unflatten(1, (-1, 3))[:, inner].double() for rows in batches)
    gap = np.concatenate([gauge.of_inner_surface(each.cpu().numpy()) for each in moved])
    checked_gaps(gap, f"{dataset.path}/{sensor}", data.press, data.step)
    volts = measured(voltage(gap, circuit), data.press, data.step, len(dataset["depth"]), circuit)
    values, rest = (torch.from_numpy(each).float().to(device) for each in (volts, voltage(gauge.rest_gap, circuit)))
    return SignalData(values, data.split, meshes, rest)


def recorded(files: RecordingFiles, folder: Path, seed: int, rest: MeshSamples) -> SignalData:
    """Read the samples in contact of recordings, split by blocks of time; with meshes if all files hold them.

    rest : meshes of the sensor whose deformed positions the files hold

    Raises `InputError` for files of another mesh.
    """
    parts, splits, displacements, least_pressed = [], [], [], []
    vertices = len(rest.rest)
    for number, path in enumerate(recording_paths(files, folder)):
        found = read_recordings(path)
        signals, contact = contact_signals(path, found, files)
        blocks = split_by_trajectory(BLOCKS, seed + number)
        parts.append(signals[contact])
        force = np.linalg.norm(found.force, axis=1)
        least_pressed.append(signals[force <= np.quantile(force, LEAST_PRESSED)])
        splits.append(blocks[np.arange(len(found)) * BLOCKS // len(found)][contact])
        if found.simulated_mesh is not None:
            if found.simulated_mesh.shape[1] != vertices:
                shape = found.simulated_mesh.shape
                raise InputError(f"{path}: nodal_res: {shape[1]} vertices; allowed: {vertices}, as {rest.sensor} has")
            displacements.append(found.simulated_mesh[contact] - rest.rest.double().cpu().numpy())
    meshes = None
    if len(displacements) == len(parts):
        steps = torch.from_numpy(np.concatenate(displacements)).float().flatten(1)
        meshes = replace(rest, steps=steps.to(rest.steps.device), scale=1.0)
    values, at_rest = (torch.from_numpy(each).float().to(rest.steps.device)
                       for each in (np.concatenate(parts), np.concatenate(least_pressed).mean(axis=0)))  # fmt: skip
    return SignalData(values, np.concatenate(splits), meshes, at_rest)


def contact_signals(path: Path, found: Recordings, settings: RecordingFiles) -> tuple[np.ndarray, np.ndarray]:
    """Signals (n, channel), without drift if the settings say so, and contact (n,) bool.

    Raises `InputError` if no sample is in contact.
    """
    contact = in_contact(found.force, settings.least_force_n)
    if not contact.any():
        raise InputError(f"{path}: no sample has a force of {settings.least_force_n:g} N; allowed: some contact")
    return _without_drift(path, found.signals, contact) if settings.remove_drift else found.signals, contact


def recording_paths(files: RecordingFiles, folder: Path) -> list[Path]:
    """Paths of the recordings of a job in ``folder``.

    Raises `InputError` for a file that is listed twice: it would be split in two ways, so that test samples would be
    training samples too.
    """
    paths = {}
    for name in files.files:
        path = folder / os.path.expanduser(name)
        if os.path.realpath(path) in paths:
            raise InputError(f"signals.recordings.files: {name} is listed twice; allowed: each file once")
        paths[os.path.realpath(path)] = path
    return list(paths.values())


def _without_drift(path: Path, signals: np.ndarray, contact: np.ndarray) -> np.ndarray:
    try:
        return without_drift(signals, contact)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
