"""The path of an indenter, along which load steps are counted by their length."""

from __future__ import annotations

import numpy as np

from simgen.config.indenter_path import moved

MAX_STEP_MM = 0.25  # longest load step; with friction the force depends on the path, so long steps change it
TURN_RADIUS_MM = 5.0  # a turn counts as an arc of this radius: half an indenter's width


class PressPath:
    """Straight lines between points, from first touch on.

    points : (d, 4), offsets of the tip from first touch, mm, and turns about the press axis, rad
    lengths : (d + 1,) mm, of the path up to first touch and to each point
    max_steps : (d,) mm, longest load step on the way to each point
    """

    def __init__(self, points: np.ndarray):
        self.points = points
        self._corners = np.vstack([np.zeros(4), points * [1.0, 1.0, 1.0, TURN_RADIUS_MM]])
        lengths = np.linalg.norm(np.diff(self._corners, axis=0), axis=1)
        self.lengths = np.concatenate([[0.0], np.cumsum(lengths)])
        self.max_steps = np.minimum(longest_segments(self._corners, lengths), MAX_STEP_MM)

    def __len__(self) -> int:
        return len(self.points)

    def offsets(self, length: np.ndarray) -> np.ndarray:
        """Offsets from first touch and turns as arcs, (env, 4) mm, after these lengths (env,) of the path."""
        return np.stack([np.interp(length, self.lengths, self._corners[:, i]) for i in range(4)], axis=-1)

    def poses(self, start: np.ndarray, length: np.ndarray) -> np.ndarray:
        """Poses (env, 4, 4) after these lengths (env,) of the path, from poses at first touch (env, 4, 4), mm."""
        offsets = self.offsets(length)
        return moved(start, offsets[:, :3], offsets[:, 3] / TURN_RADIUS_MM)


def longest_way(offsets: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Upper bound (env,) mm for the way of all points of an indenter: the tip's way, and an arc at the rim.

    offsets (env, 4): differences of `PressPath.offsets`; reach (env,): mm, of the indenter's points from the axis.
    """
    return np.linalg.norm(offsets[:, :3], axis=1) + reach * np.abs(offsets[:, 3]) / TURN_RADIUS_MM


def longest_segments(corners: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Length (d,) of the longest segment in each segment's leg; a leg is a run of segments in one direction.

    corners (d + 1, c): of the path; lengths (d,): of its segments.
    """
    directions = np.diff(corners, axis=0) / np.maximum(lengths, 1e-12)[:, None]
    turns = (directions[1:] * directions[:-1]).sum(axis=1) < 1.0 - 1e-9
    leg = np.concatenate([[0], np.cumsum(turns)])
    longest = np.zeros(leg[-1] + 1)
    np.maximum.at(longest, leg, lengths)
    return longest[leg]
