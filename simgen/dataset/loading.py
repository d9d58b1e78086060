"""Samples of a dataset for training: a sequence of named arrays, in numpy or in torch."""

import os
from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from simgen.config.outputs import READ_BY_SAMPLE, SENSOR_VALUES
from simgen.dataset.reader import Dataset
from simgen.dataset.splits import IN_NONE, SPLITS, leave_out
from simgen.errors import InputError
from simgen.fem.nonlinear.status import has_values, is_valid
from simgen.units import UM_PER_M

ESTIMATE = "surface_error_estimate_m"
SENSOR_COLUMNS = (*SENSOR_VALUES, "stated_depth")  # a sample has the ones that are in the dataset


def load_dataset(
    path: str | Path,
    split: str | None = None,
    sensors: Sequence[str] | None = None,
    left_out: str | None = None,
    include_inside_out: bool = False,
    max_error_um: float | None = None,
) -> "Samples":
    """Load the samples of a dataset that are valid on all loaded sensors: converged, without inverted elements.

    split : train, validation or test; all three by default
    sensors : names of the sensors to load; all by default
    left_out : name of an indenter. The test split has this one alone, training and validation have all others. By
        default it is the one that the dataset's job names
    include_inside_out : add converged samples with inverted elements
    max_error_um : keep samples whose surface has at most this estimated error, um, on all loaded sensors

    Raises `InputError` for an unknown name, for a dataset without the estimates, and if no sample is left.
    """
    dataset = Dataset(path)
    names = dataset.sensors if sensors is None else tuple(sensors)
    for key, value, allowed in (
        *(("sensor", name, dataset.sensors) for name in names),
        *([("split", split, tuple(SPLITS))] if split is not None else []),
    ):
        if value not in allowed:
            raise InputError(f"{path}: {key} {value!r}: allowed: {', '.join(allowed)}")
    if not names:
        raise InputError(f"{path}: no sensor is asked for; allowed: {', '.join(dataset.sensors)}")
    split_of_press = splits_without(dataset, left_out, "left_out")
    is_chosen = has_values if include_inside_out else is_valid
    there = np.all([is_chosen(dataset[f"{name}/status"]) for name in names], axis=0)
    if max_error_um is not None:
        there &= np.all([_error_um(dataset, name) <= max_error_um for name in names], axis=0)
    chosen = split_of_press != IN_NONE if split is None else split_of_press == list(SPLITS).index(split)
    if not (there & chosen[:, None]).any():
        counts = ", ".join(f"{name} {np.count_nonzero(split_of_press == code)}" for code, name in enumerate(SPLITS))
        limit = "" if max_error_um is None else f", with an estimated error of at most {max_error_um:g} um"
        raise InputError(f"{path}: no sample of split {split!r} is valid{limit}; presses: {counts}")
    return Samples(dataset.path, names, np.argwhere(there & chosen[:, None]))


def splits_without(dataset: Dataset, left_out: str | None, key: str) -> np.ndarray:
    """Splits (press,) that test an indenter alone, and use it nowhere else; None: those that are stored.

    key : names the choice in errors. Raises `InputError` for an unknown indenter, and if the dataset leaves out another
    """
    stored, split = dataset.job.dataset.leave_out, dataset["press/split"]
    if left_out is None:
        return split
    if left_out not in dataset.indenters:
        raise InputError(f"{dataset.path}: {key} {left_out!r}: allowed: {', '.join(dataset.indenters)}")
    if stored not in (None, left_out):
        raise InputError(f"{dataset.path}: {key} {left_out!r}: allowed: {stored}, which the dataset leaves out itself")
    return split if stored else leave_out(split, dataset["press/indenter"], dataset.indenters.index(left_out))


def _error_um(dataset: Dataset, sensor: str) -> np.ndarray:
    """Estimated errors (press, depth) of the surface, um; raises `InputError` if the dataset has none."""
    name = f"{sensor}/{ESTIMATE}"
    if name not in dataset.arrays:
        advice = f"a job that asks for them has outputs: {{{sensor}: [{ESTIMATE}]}}"
        raise InputError(f"{dataset.path}: max_error_um: {sensor} has no error estimates; {advice}")
    return dataset[name] * UM_PER_M


class Samples(Sequence):
    """Samples by number, made by `load_dataset`: ``samples[0]["digit/displacement"]``.

    sensors : names
    rows : (sample, 2), press and index of the depth
    """

    def __init__(self, path: Path, sensors: tuple[str, ...], rows: np.ndarray):
        self.path, self.sensors, self.rows = path.resolve(), sensors, rows
        self._opened: tuple[int, Dataset] | None = None

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, number: int | slice) -> "dict[str, np.ndarray] | Samples":
        """One sample as a dictionary, or `Samples` for a slice.

        Values are float32 in the dataset's units; indices are int64.

        ``<sensor>/displacement`` (vertex, 3), ``<sensor>/force`` (3,), ...: the outputs of `simgen.config.outputs` that
        the dataset has, without status and certificates.

        ``depth``, ``press``, ``trajectory``, and ``indenter``, an index into `indenters`. Imported samples may add
        ``<sensor>/stated_depth``, from their files. Paths with legs add ``offset`` (3,) and ``turn`` in the contact
        frame, and ``leg``.
        """
        if isinstance(number, slice):
            return Samples(self.path, self.sensors, self.rows[number])
        press, step = map(int, self.rows[number])
        shared = self._columns
        sample = {key: np.int64(shared[f"press/{key}"][press]) for key in ("trajectory", "indenter")}
        sample |= {"press": np.int64(press), "depth": np.float32(shared["depth"][step])}
        path = self.dataset.indenter_path
        if not path.is_a_press:
            sample |= {"offset": np.float32(path.offsets_m[step]), "turn": np.float32(path.turns_rad[step])}
            sample["leg"] = np.int64(path.legs[step])
        for sensor in self.sensors:
            displacement = self.dataset.displacement(sensor, press, step)
            sample[f"{sensor}/displacement"] = displacement.astype(np.float32)
            for name in (f"{sensor}/{key}" for key in READ_BY_SAMPLE):
                if name in self.dataset.arrays:
                    sample[name] = self.dataset.in_unit(name, press, step).astype(np.float32)
            for name in (f"{sensor}/{key}" for key in SENSOR_COLUMNS):
                if name in shared:
                    sample[name] = np.float32(shared[name][press, step])
        return sample

    @property
    def dataset(self) -> Dataset:
        """The dataset, opened once per process."""
        if self._opened is None or self._opened[0] != os.getpid():
            self._opened = (os.getpid(), Dataset(self.path))
        return self._opened[1]

    @cached_property
    def _columns(self) -> dict[str, np.ndarray]:
        names = ["depth", "press/trajectory", "press/indenter"]
        names += [f"{sensor}/{key}" for sensor in self.sensors for key in SENSOR_COLUMNS]
        return {name: self.dataset[name] for name in names if name in self.dataset.root}

    @property
    def indenters(self) -> tuple[str, ...]:
        return self.dataset.indenters

    @cached_property
    def rest_positions(self) -> dict[str, np.ndarray]:
        """Rest positions (vertex, 3) m by sensor, in the sensor's frame."""
        return {sensor: self.dataset[f"{sensor}/rest_positions"] for sensor in self.sensors}

    def torch(self) -> "TorchSamples":
        """The same samples as a map-style dataset of tensors. Only this call imports torch."""
        import torch

        return TorchSamples(self, torch.as_tensor)

    def __getstate__(self) -> dict[str, Any]:
        return {"path": self.path, "sensors": self.sensors, "rows": self.rows, "_opened": None}


class TorchSamples:
    """Samples as torch tensors: a map-style dataset for `torch.utils.data.DataLoader`, with any number of workers."""

    def __init__(self, samples: Samples, as_tensor: Callable[[Any], Any]):
        self.samples, self._as_tensor = samples, as_tensor

    def __len__(self) -> int:
        return len(self.samples)

    def __getitem__(self, number: int) -> dict[str, Any]:
        """One sample of `Samples`, in tensors."""
        return {name: self._as_tensor(value) for name, value in self.samples[number].items()}
