"""Selection of samples for export: sensors, and presses by trajectory and split."""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np

from simgen.config.indenter_path import moved
from simgen.dataset.exchange.result_files import Sample
from simgen.dataset.pressed_indenters import first_touch
from simgen.dataset.reader import Dataset
from simgen.dataset.splits import SPLITS
from simgen.errors import InputError
from simgen.fem.nonlinear.status import is_valid

SHOWN = 12  # most numbers in a message


class Track(Protocol):
    """Shows the progress of a loop, as ``rich.progress.track`` does."""

    def __call__(self, sequence: Sequence, description: str) -> Iterable: ...


def untracked(sequence: Sequence, description: str) -> Iterable:
    """Show no progress."""
    return sequence


@dataclass(frozen=True)
class PressSelection:
    """Presses (n,) of a dataset, rising, on some of its sensors."""

    dataset: Dataset
    sensors: tuple[str, ...]
    presses: np.ndarray

    @cached_property
    def paired(self) -> np.ndarray:
        """Mask (n, depth) of samples that are valid on all sensors of the selection."""
        return np.all([is_valid(self.dataset[f"{sensor}/status"][self.presses]) for sensor in self.sensors], axis=0)

    def check(self) -> None:
        """Raise `InputError` if no sample is selected."""
        if not self.paired.any():
            on = " and ".join(self.sensors)
            raise InputError(f"{self.dataset.path}: no selected sample is valid on {on}")

    def by_trajectory(self) -> dict[int, "PressSelection"]:
        """Divide the selection by trajectory."""
        own = self.dataset["press/trajectory"][self.presses]
        return {int(i): PressSelection(self.dataset, self.sensors, self.presses[own == i]) for i in np.unique(own)}


def select(
    dataset: Dataset, sensors: Sequence[str] = (), trajectories: str | None = None, split: str | None = None
) -> PressSelection:
    """Select by sensors (default: all), by trajectories, text such as ``0:10`` (end excluded) or ``3,7``, and by split.

    Raises `InputError` for an unknown name or number, and for an empty selection.
    """
    for sensor in sensors:
        if sensor not in dataset.sensors:
            raise InputError(f"--sensor {sensor!r}: {dataset.path} has {', '.join(dataset.sensors)}")
    trajectory = dataset["press/trajectory"]
    chosen = np.ones(len(trajectory), bool)
    if trajectories is not None:
        chosen &= np.isin(trajectory, _numbers(dataset.path, trajectories, trajectory))
    if split is not None:
        if split not in SPLITS:
            raise InputError(f"--split {split!r}: allowed: {', '.join(SPLITS)}")
        chosen &= dataset["press/split"] == list(SPLITS).index(split)
    if not chosen.any():
        of = f" of --trajectories {trajectories}" if trajectories else ""
        raise InputError(f"--split {split}: no trajectory{of} of {dataset.path} is in it")
    return PressSelection(dataset, tuple(sensors) or dataset.sensors, np.flatnonzero(chosen))


def _numbers(path: Path, text: str, there: np.ndarray) -> list[int]:
    """Parse numbers of trajectories. Raises `InputError` for one that the dataset lacks."""
    numbers: list[int] = []
    for part in text.split(","):
        if not (match := re.fullmatch(r"\s*(\d+)\s*(?::\s*(\d+)\s*)?", part)):
            raise InputError(f"--trajectories {text!r}: write it as 0:10 (the end excluded), 3,7 or both")
        first = int(match[1])
        end = int(match[2]) if match[2] else first + 1
        if end <= first:
            raise InputError(f"--trajectories {text!r}: {part.strip()} is empty; its end is excluded")
        known = set(there.tolist())
        if (missing := next((number for number in range(first, end) if number not in known), None)) is not None:
            raise InputError(f"--trajectories {text!r}: {path} has no trajectory {missing}; it has {_shown(there)}")
        numbers += range(first, end)
    return numbers


def _shown(numbers: np.ndarray) -> str:
    known = np.unique(numbers)
    if len(known) == known[-1] - known[0] + 1:
        return f"{known[0]} to {known[-1]}"
    return ", ".join(map(str, known[:SHOWN])) + (", ..." if len(known) > SHOWN else "")


class SensorSamples:
    """The valid samples of one sensor, in its frame."""

    def __init__(self, dataset: Dataset, sensor: str):
        self.dataset, self.sensor = dataset, sensor
        self.offsets, self.turns = dataset.offsets_of(sensor), dataset.indenter_path.turns_rad
        self.trajectory, self.indenter = dataset["press/trajectory"], dataset["press/indenter"]
        self.rest, self.sensor_pose = dataset[f"{sensor}/rest_positions"], dataset[f"{sensor}/pose"]
        self.valid, self.force = is_valid(dataset[f"{sensor}/status"]), dataset[f"{sensor}/force"]
        self.first_touch = first_touch(dataset, sensor)

    def of(self, presses: Iterable[int]) -> Iterator[Sample]:
        """Yield the valid samples of presses, with one press in memory at a time."""
        for press in presses:
            steps = np.flatnonzero(self.valid[press])
            displacement = self.dataset.displacement(self.sensor, int(press)) if len(steps) else ()
            for step in steps:
                yield Sample(
                    trial=int(self.trajectory[press]),
                    env=int(self.indenter[press]),
                    step=int(step),
                    nodal_coordinates=self.rest + displacement[step],
                    force=self.force[press, step],
                    indenter=self.dataset.indenters[self.indenter[press]],
                    pose=_known(moved(self.first_touch[press], self.offsets[press, step], self.turns[step])),
                    depth_m=float(self.offsets[press, step, 1]),
                    sensor_pose=_known(self.sensor_pose[press]),
                )


def _known(pose: np.ndarray) -> np.ndarray | None:
    return pose if np.isfinite(pose).all() else None


def vertex_flags(dataset: Dataset, sensor: str) -> dict[str, np.ndarray]:
    """Flags of the vertices that the dataset has, held and touchable, (vertex,) uint8 each."""
    found = {name: dataset.get(f"{sensor}/{name}") for name in ("held", "touchable")}
    return {name: flags.astype(np.uint8) for name, flags in found.items() if flags is not None}
