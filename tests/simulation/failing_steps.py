"""Load steps that fail, so that a press gets a second try."""

import numpy as np

from simgen.fem.nonlinear.status import Status
from simgen.simulation.load_stepping import LoadStepping


def fail_beyond(monkeypatch, furthest_mm):
    """Make load steps fail that end beyond ``furthest_mm`` (in the first try, in the second)."""
    accept = LoadStepping._accept_or_reject

    def fail(stepping, ended):
        tries = np.array(
            [
                int(press is not None and each is not press.tries[0])
                for press, each in zip(stepping.press, stepping.tries, strict=True)
            ]
        )
        beyond = ended & (stepping.target > np.array(furthest_mm)[tries])
        stepping.solver.increment.status[beyond] = Status.NEWTON_STALLED
        accept(stepping, ended)

    monkeypatch.setattr(LoadStepping, "_accept_or_reject", fail)
