"""The path of an indenter: its offset from first touch and its turn at each stored step.

A path is given in the contact frame: the indenter's own frame at first touch. The origin is the tip, +y is the press
axis and points into the sensor, and x and z lie in the surface. A press is a path along +y.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

DOWN = np.array([0.0, 1.0, 0.0])  # the press axis in the contact frame


@dataclass(frozen=True)
class IndenterPath:
    """The steps of a path, in the contact frame.

    offsets_m : (step, 3) m, offset of the tip from first touch
    turns_rad : (step,) rad, right-handed turn of the indenter about the press axis
    legs : (step,) int32, number of the leg that the step belongs to; 0 is the press
    """

    offsets_m: np.ndarray
    turns_rad: np.ndarray
    legs: np.ndarray

    def __len__(self) -> int:
        return len(self.offsets_m)

    @property
    def depths_m(self) -> np.ndarray:
        """(step,) m, offset along the press axis."""
        return self.offsets_m[:, 1]

    @property
    def is_a_press(self) -> bool:
        """True if no legs follow the press."""
        return not self.legs.any()

    def label(self, step: int) -> str:
        """A step in words: its depth; on a leg also x, z and the turn."""
        x, depth, z = 1e3 * self.offsets_m[step]
        place = f"{depth:g} mm"
        if self.legs[step]:
            place += f", x {x:g} mm, z {z:g} mm, {np.degrees(self.turns_rad[step]):.4g} deg"
        return place

    @property
    def lateral_reach_m(self) -> float:
        """m, largest distance of the tip from the press axis at or below the rest surface."""
        ends = np.vstack([np.zeros(3), self.offsets_m])
        reach = 0.0
        for start, end in pairwise(ends):
            if start[1] < 0.0 or end[1] < 0.0:
                if max(start[1], end[1]) <= 0.0:
                    continue
                surface = start + start[1] / (start[1] - end[1]) * (end - start)
                start, end = (surface, end) if start[1] < 0.0 else (start, surface)
            reach = max(reach, np.hypot(start[0], start[2]), np.hypot(end[0], end[2]))
        return float(reach)


def press_path(depths_m: np.ndarray) -> IndenterPath:
    """Make the path of a press to depths (step,) m."""
    depths_m = np.asarray(depths_m, dtype=float)
    count = len(depths_m)
    return IndenterPath(depths_m[:, None] * DOWN, np.zeros(count), np.zeros(count, np.int32))


def with_legs(press: IndenterPath, legs: Sequence[tuple[Sequence[float], float, int]]) -> IndenterPath:
    """Append legs ``(move (3,) m, turn rad, steps)`` to a press. Each leg starts at the end of the one before.

    Steps are evenly spaced. Offsets are rounded to nanometres and turns to 1e-12 rad, so that all machines agree.
    """
    offsets, turns = [press.offsets_m], [press.turns_rad]
    numbers = [press.legs]
    for number, (move, turn, steps) in enumerate(legs, start=1):
        share = np.arange(1, steps + 1) / steps
        offsets.append(np.round(offsets[-1][-1] + share[:, None] * np.asarray(move), 9))
        turns.append(np.round(turns[-1][-1] + share * turn, 12))
        numbers.append(np.full(steps, number, np.int32))
    return IndenterPath(np.concatenate(offsets), np.concatenate(turns), np.concatenate(numbers))


def moved(poses: np.ndarray, offsets: np.ndarray, turns_rad: np.ndarray | float = 0.0) -> np.ndarray:
    """Move poses (..., 4, 4) by offsets (..., 3) along their own axes, and turn them (...) rad about their own +y.

    Offsets are in the unit of the poses.
    """
    turned = poses.copy()
    turned[..., :3, 3] += np.einsum("...ij,...j->...i", poses[..., :3, :3], offsets)
    turned[..., :3, :3] = poses[..., :3, :3] @ turn_about_press_axis(turns_rad)
    return turned


def turn_about_press_axis(turns_rad: np.ndarray | float) -> np.ndarray:
    """Rotation matrices (..., 3, 3): right-handed turns (...) rad about +y."""
    turns_rad = np.asarray(turns_rad, dtype=float)
    rotation = np.zeros((*turns_rad.shape, 3, 3))
    rotation[..., 1, 1] = 1.0
    rotation[..., 0, 0] = rotation[..., 2, 2] = np.cos(turns_rad)
    rotation[..., 0, 2] = np.sin(turns_rad)
    rotation[..., 2, 0] = -rotation[..., 0, 2]
    return rotation
