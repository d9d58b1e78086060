"""Outcomes of a press at one depth, each with a sentence for users.

A sample is **converged** if its forces balance, and **valid** if in addition no element is inverted. A press
**fails** where the solver finds no state, and **ends as planned** where the job or the geometry stops it.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Status(IntEnum):
    """Outcome of a press at one depth; ``sentence`` says what it means and what to try.

    ``has_values``: forces and displacements of this depth are stored. ``is_planned_end``: the press ended as planned.
    ``is_failure``: neither.
    """

    CONVERGED = 0
    NEWTON_STALLED = 1
    INVERTED = 2  # in older datasets only: Newton's method now passes through such states
    LINEAR_SOLVER_STALLED = 3
    NEVER_TOUCHES = 4
    STARTS_INSIDE = 5
    NOT_RESOLVED = 6
    FORCE_LIMIT = 7
    NO_ROOM = 8
    INSIDE_OUT = 9

    @property
    def sentence(self) -> str:
        return _SENTENCES[self]

    @property
    def has_values(self) -> bool:
        return self in (Status.CONVERGED, Status.INSIDE_OUT)

    @property
    def is_planned_end(self) -> bool:
        return self in (Status.FORCE_LIMIT, Status.NO_ROOM)

    @property
    def is_failure(self) -> bool:
        return not (self.has_values or self.is_planned_end)


_SENTENCES = {
    Status.CONVERGED: "Converged: residual and contact constraint are within the job's tolerances.",
    Status.NEWTON_STALLED: "Newton's method did not converge even in the smallest sub-step; try a finer mesh, or less "
    "friction.",
    Status.INVERTED: "An element would turn inside out even in the smallest sub-step; try a finer mesh or a smaller "
    "depth.",
    Status.LINEAR_SOLVER_STALLED: "The linear solver did not reach its tolerance even in the smallest sub-step; try a "
    "larger krylov_size.",
    Status.NEVER_TOUCHES: "The indenter does not meet the touchable surface along its axis; check its pose.",
    Status.STARTS_INSIDE: "The indenter already overlaps the sensor where it starts; start it further away.",
    Status.NOT_RESOLVED: "The mesh does not resolve the contact: the surface overlaps the indenter, the core or the "
    "support by too much of a face; try a finer mesh, or a smaller depth.",
    Status.FORCE_LIMIT: "As planned, the press ended where its force exceeded the job's max_force_n.",
    Status.NO_ROOM: "As planned, the press ended where too little gel would be left under the indenter.",
    Status.INSIDE_OUT: "Converged, but an element is inside out somewhere: load_dataset leaves the sample out by "
    "default.",
}

NOT_THERE = -1  # code of a sample that no task has written yet


def is_valid(codes: np.ndarray) -> np.ndarray:
    """Samples that are converged and have no inverted element, by their codes; bool of the same shape."""
    return np.asarray(codes) == Status.CONVERGED


def has_values(codes: np.ndarray) -> np.ndarray:
    """Samples that are converged, by their codes: their values are stored; bool of the same shape."""
    return _are(codes, "has_values")


def is_planned_end(codes: np.ndarray) -> np.ndarray:
    """Depths that a press does not reach as planned, by their codes; bool of the same shape."""
    return _are(codes, "is_planned_end")


def is_failure(codes: np.ndarray) -> np.ndarray:
    """Depths that a press fails to reach, by their codes; bool of the same shape. Unknown codes are failures."""
    return ~(has_values(codes) | is_planned_end(codes)) & (np.asarray(codes) != NOT_THERE)


def in_words(code: int) -> str:
    """The kind of a code in words, as they follow a number of samples."""
    if code == NOT_THERE:
        return "not there yet"
    if code == Status.INSIDE_OUT:
        return "inside out"
    if is_planned_end(code):
        return "not pressed"
    return "failed" if is_failure(code) else "converged"


def _are(codes: np.ndarray, kind: str) -> np.ndarray:
    return np.isin(codes, [status for status in Status if getattr(status, kind)])
