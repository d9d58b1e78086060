"""How a press can end at one depth: each outcome is a sentence that says what to try."""

from __future__ import annotations

from enum import IntEnum


class Status(IntEnum):
    """Outcome of a press at one depth; ``sentence`` says what it means and what to try."""

    CONVERGED = 0
    NEWTON_STALLED = 1
    INVERTED = 2
    LINEAR_SOLVER_STALLED = 3
    NEVER_TOUCHES = 4
    STARTS_INSIDE = 5
    NOT_RESOLVED = 6

    @property
    def sentence(self) -> str:
        return _SENTENCES[self]


_SENTENCES = {
    Status.CONVERGED: "Converged: residual and contact constraint are within the job's tolerances.",
    Status.NEWTON_STALLED: "Newton's method did not converge even in the smallest sub-step; try a finer mesh, or less "
    "friction.",
    Status.INVERTED: "An element would turn inside out even in the smallest sub-step; try a finer mesh or a smaller "
    "depth.",
    Status.LINEAR_SOLVER_STALLED: "The linear solver did not reach its tolerance even in the smallest sub-step; try a "
    "larger krylov_size.",
    Status.NEVER_TOUCHES: "The indenter does not meet the touchable surface along its axis; check its pose.",
    Status.NOT_RESOLVED: "The mesh does not resolve the contact: the surface overlaps the indenter or the core by too "
    "much of a face; try a finer mesh, or a smaller depth.",
    Status.STARTS_INSIDE: "The indenter already overlaps the sensor where it starts; start it further away.",
}
