"""A dataset as tensors on one device: all samples that are valid on all sensors.

Displacements stay in the stored int16 steps, 2 bytes a coordinate. 123,000 samples of the DIGIT's 6,198 vertices take
4.6 GB, so that a GPU holds a whole dataset and a batch is a list of row numbers.
"""

import hashlib
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from simgen.dataset.layout import checked
from simgen.dataset.loading import splits_without
from simgen.dataset.reader import Dataset
from simgen.dataset.splits import SPLITS
from simgen.errors import InputError
from simgen.fem.nonlinear.status import is_valid

Track = Callable[[list, str], list]  # items and what they are -> the same items, with progress shown
BATCH = 512  # samples at once where nothing is trained


@dataclass(frozen=True)
class MeshSamples:
    """Displacements of one sensor in all samples."""

    sensor: str
    rest: Tensor  # (vertex, 3) float32, m, in the sensor's frame
    tetrahedra: np.ndarray  # (tet, 4)
    surface_triangles: np.ndarray  # (triangle, 3)
    steps: Tensor  # (sample, vertex * 3) int16, or float32
    scale: float  # m a step

    def displacement(self, rows: Tensor) -> Tensor:
        """Displacements (n, vertex, 3) float32, m, of rows (n,)."""
        return (self.steps[rows].float() * self.scale).view(len(rows), -1, 3)

    def mean_and_deviation(self, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation of displacements over rows, (vertex, 3) float32 each, m."""
        batches = rows.split(BATCH)
        mean = sum(self.displacement(batch).double().sum(0) for batch in batches) / len(rows)
        square = sum(((self.displacement(batch) - mean) ** 2).sum(0) for batch in batches) / len(rows)
        return mean.float(), square.sqrt().float()


@dataclass(frozen=True)
class TrainingData:
    """Samples by row number: press after press, depths in order."""

    dataset: Dataset
    meshes: dict[str, MeshSamples]
    press: np.ndarray  # (sample,) number in the dataset
    step: np.ndarray  # (sample,) index of the depth
    trajectory: np.ndarray  # (sample,)
    indenter: np.ndarray  # (sample,) index into the dataset's indenters
    split: np.ndarray  # (sample,) index into SPLITS, or -1
    depth: np.ndarray  # (sample,) m

    def __len__(self) -> int:
        return len(self.press)

    def rows(self, split: str) -> Tensor:
        """Row numbers (n,) of a split, on the device of the meshes. Raises `InputError` if there are none."""
        rows = np.flatnonzero(self.split == list(SPLITS).index(split))
        if not len(rows):
            counts = ", ".join(f"{name} {np.count_nonzero(self.split == code)}" for code, name in enumerate(SPLITS))
            raise InputError(f"{self.dataset.path}: no sample of split {split}; samples: {counts}; more trajectories?")
        device = next(iter(self.meshes.values())).steps.device
        return torch.from_numpy(rows).to(device)


def load_training_data(
    path: str | Path, sensors: tuple[str, ...], device: torch.device, track: Track, leave_out: str | None = None
) -> TrainingData:
    """Read a dataset onto a device.

    leave_out : an indenter that is tested alone, and not trained; None: splits as the dataset has them

    Raises `InputError` for a missing sensor or indenter, or without a valid sample.
    """
    dataset = checked(Dataset(path))
    for sensor in sensors:
        if sensor not in dataset.sensors:
            raise InputError(f"{path}: sensor {sensor!r}: allowed: {', '.join(dataset.sensors)}")
    valid = np.all([is_valid(dataset[f"{sensor}/status"]) for sensor in sensors], axis=0)
    if not valid.any():
        raise InputError(f"{path}: no sample is valid on {' and '.join(sensors)}")
    press, step = np.nonzero(valid)
    columns = {name: dataset[f"press/{name}"][press] for name in ("trajectory", "indenter")}
    columns["split"] = splits_without(dataset, leave_out, "leave_out")[press]
    meshes = {sensor: _load_meshes(dataset, sensor, valid, device, track) for sensor in sensors}
    return TrainingData(dataset, meshes, press, step, depth=dataset["depth"][step], **columns)


def _load_meshes(
    dataset: Dataset, sensor: str, valid: np.ndarray, device: torch.device, track: Track
) -> MeshSamples:
    """Read the ``valid`` (press, depth) samples of a sensor; threads read one shard each."""
    rest = dataset[f"{sensor}/rest_positions"]
    scale = dataset.displacement_scale(sensor)
    first = np.concatenate([[0], np.cumsum(valid.sum(axis=1))])
    steps = np.empty((first[-1], rest.size), np.float32 if scale is None else np.int16)

    def read(shard: int) -> None:
        presses = dataset.shard_presses(shard)
        rows = slice(presses.start, presses.stop)
        if valid[rows].any():
            stored = dataset.stored_displacement(sensor, rows)[valid[rows]]
            steps[first[presses.start] : first[presses.stop]] = stored.reshape(-1, rest.size)

    with ThreadPoolExecutor(os.cpu_count()) as threads:
        for reading in track([threads.submit(read, shard) for shard in range(dataset.shards)], sensor):
            reading.result()
    return MeshSamples(
        sensor,
        torch.from_numpy(rest).float().to(device),
        dataset[f"{sensor}/tetrahedra"],
        dataset[f"{sensor}/surface_triangles"],
        torch.from_numpy(steps).to(device),
        1.0 if scale is None else scale,
    )


def mesh_hash(tetrahedra: np.ndarray) -> str:
    """Hash the vertex numbers of tetrahedra (tet, 4) by sha256. Coordinates, and so rounding, play no part."""
    return hashlib.sha256(np.ascontiguousarray(tetrahedra, "<i4").tobytes()).hexdigest()
