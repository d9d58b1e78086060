"""Preparation of electrode signals for learning: detects contact, removes drift, scales channels."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from simgen.errors import InputError

# Ten times the resolution of 0.01 N that the sensor's maker states. Electrodes cannot detect weaker contacts.
LEAST_FORCE_N = 0.1


def in_contact(force: np.ndarray, least: float = LEAST_FORCE_N) -> np.ndarray:
    """True for samples in contact: (n,) bool, where forces (n, 3), N, have a norm of at least ``least``.

    Raises `InputError` for forces of another shape or not finite, and for a threshold below 0.
    """
    force = np.asarray(force, dtype=float)
    if force.ndim != 2 or force.shape[1] != 3:
        raise InputError(f"force: shape {force.shape}; allowed: (n, 3) in N")
    if not np.isfinite(force).all():
        raise InputError("force: values that are not finite numbers")
    if not 0.0 <= least < np.inf:
        raise InputError(f"least force: {least:g} N; allowed: 0 or more")
    return np.linalg.norm(force, axis=1) >= least


def without_drift(signals: np.ndarray, contact: np.ndarray, time: np.ndarray | None = None) -> np.ndarray:
    """Signals (n, channel) without linear drift.

    contact : (n,) bool. A straight line per channel is fitted (least squares) to the samples without contact.
    time : (n,) in any unit; by default the number of the sample

    The line is subtracted from all samples. It is zero at the first sample, so signals keep their level there.

    Raises `InputError` if shapes do not fit, or if fewer than two samples without contact differ in time.
    """
    signals, contact = _signals(signals), np.asarray(contact)
    time = np.arange(len(signals), dtype=float) if time is None else np.asarray(time, dtype=float)
    for name, values in (("contact", contact), ("time", time)):
        if values.shape != signals.shape[:1]:
            raise InputError(f"{name}: shape {values.shape}; allowed: {signals.shape[:1]}, a value for each sample")
    if contact.dtype != bool:
        raise InputError(f"contact: {contact.dtype}; allowed: bool")
    if not np.isfinite(time).all():
        raise InputError("time: values that are not finite numbers")
    free = time[~contact]
    if len(np.unique(free)) < 2:
        raise InputError(f"drift: {len(free)} samples without contact; allowed: 2 or more, at different times")
    around = free - free.mean()
    slope = around @ signals[~contact] / (around @ around)
    return signals - np.outer(time - time[0], slope)


@dataclass(frozen=True)
class Scaling:
    """Linear scaling of each channel from its range in the training split to [-1, 1].

    low, high : one number per channel. A constant channel is shifted to 0 and not scaled.

    ``dataclasses.asdict`` gives JSON, and ``Scaling(**json)`` restores it. Raises `InputError` for bad values.
    """

    low: tuple[float, ...]
    high: tuple[float, ...]

    def __post_init__(self):
        for name in ("low", "high"):
            values = np.asarray(getattr(self, name), dtype=float)
            if values.ndim != 1 or not np.isfinite(values).all():
                raise InputError(f"scaling: {name}: allowed: a finite number for each channel")
            object.__setattr__(self, name, tuple(values.tolist()))
        if len(self.low) != len(self.high):
            raise InputError(f"scaling: {len(self.low)} low, {len(self.high)} high; allowed: one each per channel")
        if wrong := [channel for channel, (a, b) in enumerate(zip(self.low, self.high, strict=True)) if a > b]:
            raise InputError(f"scaling: channel {wrong[0]}: low above high; allowed: low up to high")

    @classmethod
    def fit(cls, signals: np.ndarray) -> Self:
        """Fit to signals (n, channel) of the training split."""
        signals = _signals(signals)
        return cls(tuple(signals.min(axis=0)), tuple(signals.max(axis=0)))

    def apply(self, signals: np.ndarray) -> np.ndarray:
        """Scale signals (n, channel)."""
        middle, half = self._middle_and_half()
        return (self._checked(signals) - middle) / half

    def invert(self, scaled: np.ndarray) -> np.ndarray:
        """Signals (n, channel) in their unit, from scaled ones."""
        middle, half = self._middle_and_half()
        return self._checked(scaled) * half + middle

    def _middle_and_half(self) -> tuple[np.ndarray, np.ndarray]:
        low, high = np.array(self.low), np.array(self.high)
        return 0.5 * (low + high), np.where(high > low, 0.5 * (high - low), 1.0)

    def _checked(self, values: np.ndarray) -> np.ndarray:
        values = np.asarray(values, dtype=float)
        if values.ndim != 2 or values.shape[1] != len(self.low):
            raise InputError(f"signals: shape {values.shape}; allowed: (n, {len(self.low)})")
        return values


def _signals(signals: np.ndarray) -> np.ndarray:
    signals = np.asarray(signals, dtype=float)
    if signals.ndim != 2 or not len(signals):
        raise InputError(f"signals: shape {signals.shape}; allowed: (n, channel), n at least 1")
    if not np.isfinite(signals).all():
        raise InputError("signals: values that are not finite numbers")
    return signals
