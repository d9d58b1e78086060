"""Table of all presses of a dataset, with filters, and the way from one press to the next."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np

from simgen.config.outputs import BY_COARSER_MESH
from simgen.dataset.exchange.importing import ABSENT
from simgen.dataset.reader import Dataset
from simgen.dataset.splits import split_names
from simgen.errors import InputError
from simgen.fem.nonlinear.status import NOT_THERE, has_values, in_words
from simgen.units import MM_PER_M, UM_PER_M

# Kinds of outcomes, as `in_words` names them, from the best to the worst.
STATUSES = ("converged", "not pressed", "inside out", "not there yet", "failed")
(SURFACE_ERROR,) = BY_COARSER_MESH


@dataclass(frozen=True)
class Filter:
    """Conditions on the presses that are shown; None allows everything.

    indenter, split : names
    status : one of `STATUSES`, the worst of all sensors and depths
    largest_error_um : no estimated error of the surface is larger; presses without an estimate are left out
    least_depth_mm : the press gets at least as deep on all sensors
    """

    indenter: str | None = None
    split: str | None = None
    status: str | None = None
    largest_error_um: float | None = None
    least_depth_mm: float | None = None


@dataclass(frozen=True)
class PressRow:
    """One press of the table; depths and numbers of steps by sensor, the error is None without an estimate."""

    press: int
    trajectory: int
    indenter: str
    split: str
    status: str
    depth_mm: Mapping[str, float]
    steps_reached: Mapping[str, int]
    error_um: float | None


@dataclass(frozen=True)
class PressTable:
    """All presses of a dataset, which may be unfinished.

    sensors, indenters : names
    trajectory, indenter : (press,) numbers
    split : (press,) names, or none
    status : (press,) worst of `STATUSES` over all sensors and depths
    steps_reached : (press, sensor) number of depths, from the first on, with values
    depth_mm : (press, sensor) the deepest of these; 0 without any
    error_um : (press,) largest estimated error of the surface over all sensors and depths; NaN without an estimate
    """

    sensors: tuple[str, ...]
    indenters: tuple[str, ...]
    trajectory: np.ndarray
    indenter: np.ndarray
    split: np.ndarray
    status: np.ndarray
    steps_reached: np.ndarray
    depth_mm: np.ndarray
    error_um: np.ndarray

    @classmethod
    def of_dataset(cls, dataset: Dataset) -> Self:
        """Read the table. Raises `InputError` if an array is missing or cannot be read."""
        codes = np.stack([dataset[f"{sensor}/status"] for sensor in dataset.sensors], axis=1)
        reached = np.logical_and.accumulate(has_values(codes), axis=2)
        depths = np.stack([dataset.depths_of(sensor) for sensor in dataset.sensors], axis=1)
        return cls(
            dataset.sensors,
            dataset.indenters,
            dataset["press/trajectory"],
            dataset["press/indenter"],
            split_names(dataset["press/split"]),
            np.array(STATUSES)[_severity(codes).max(axis=(1, 2))],
            reached.sum(axis=2),
            MM_PER_M * np.where(reached, depths, 0.0).max(axis=2),
            _largest_error(dataset, has_values(codes)),
        )

    def __len__(self) -> int:
        return len(self.trajectory)

    @property
    def has_estimates(self) -> bool:
        return bool(np.isfinite(self.error_um).any())

    def matching(self, wanted: Filter) -> np.ndarray:
        """Numbers (m,) of the presses that pass a filter, rising.

        Raises `InputError` for an unknown indenter, split or status.
        """
        _check(wanted, self.indenters)
        passes = np.ones(len(self), bool)
        if wanted.indenter is not None:
            passes &= self.indenter == self.indenters.index(wanted.indenter)
        if wanted.split is not None:
            passes &= self.split == wanted.split
        if wanted.status is not None:
            passes &= self.status == wanted.status
        if wanted.largest_error_um is not None:
            passes &= self.error_um <= wanted.largest_error_um
        if wanted.least_depth_mm is not None:
            passes &= self.depth_mm.min(axis=1) >= wanted.least_depth_mm - 1e-9  # mm, for rounded depths
        return np.flatnonzero(passes)

    def find(self, trajectory: int, indenter: int | str) -> int | None:
        """Number of the press of an indenter, by number or name, at a contact; None if there is none."""
        if isinstance(indenter, str):
            indenter = self.indenters.index(indenter)
        found = np.flatnonzero((self.trajectory == trajectory) & (self.indenter == indenter))
        return int(found[0]) if len(found) else None

    def furthest(self) -> int:
        """The first press that gets through most depths on all sensors: the one to begin with."""
        return int(self.steps_reached.min(axis=1).argmax())

    def row(self, press: int) -> PressRow:
        error = float(self.error_um[press])
        return PressRow(
            int(press),
            int(self.trajectory[press]),
            self.indenters[self.indenter[press]],
            str(self.split[press]),
            str(self.status[press]),
            dict(zip(self.sensors, self.depth_mm[press].tolist(), strict=True)),
            dict(zip(self.sensors, self.steps_reached[press].tolist(), strict=True)),
            error if np.isfinite(error) else None,
        )


def following(press: int, among: np.ndarray) -> int | None:
    """The next of rising numbers ``among`` after a press, which need not be one of them; None after the last."""
    place = np.searchsorted(among, press, side="right")
    return int(among[place]) if place < len(among) else None


def preceding(press: int, among: np.ndarray) -> int | None:
    """The last of rising numbers ``among`` before a press; None before the first."""
    place = np.searchsorted(among, press, side="left")
    return int(among[place - 1]) if place else None


def kind_of(code: int) -> str:
    """Kind of a status code, one of `STATUSES`."""
    return in_words(NOT_THERE) if code == ABSENT else in_words(code)


def _severity(codes: np.ndarray) -> np.ndarray:
    """Places in `STATUSES` of status codes, of the same shape."""
    known, place = np.unique(codes, return_inverse=True)
    return np.array([STATUSES.index(kind_of(code)) for code in known.tolist()])[place].reshape(codes.shape)


def _largest_error(dataset: Dataset, has_values: np.ndarray) -> np.ndarray:
    """Largest estimated errors (press,), um, of the samples (press, sensor, depth) with values; NaN without one."""
    largest = np.full(dataset.presses, np.nan)
    for number, sensor in enumerate(dataset.sensors):
        if (name := f"{sensor}/{SURFACE_ERROR}") in dataset.arrays:
            own = np.where(has_values[:, number], UM_PER_M * np.abs(dataset[name]), np.nan)
            largest = np.fmax(largest, np.fmax.reduce(own, axis=1))
    return largest


def _check(wanted: Filter, indenters: tuple[str, ...]) -> None:
    splits = tuple(split_names(np.arange(-1, 3)).tolist())
    for key, allowed in (("indenter", indenters), ("split", splits), ("status", STATUSES)):
        value = getattr(wanted, key)
        if value is not None and value not in allowed:
            raise InputError(f"filter: {key}: {value!r}; allowed: {', '.join(allowed)}")
