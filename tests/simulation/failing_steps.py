"""Load steps that fail, so that a press gets other tries."""

import numpy as np

from simgen.fem.nonlinear.status import Status
from simgen.simulation.load_stepping import LoadStepping


def fail_beyond(monkeypatch, furthest_mm):
    """Make load steps fail that end beyond ``furthest_mm`` (in the first try, in the second, ...)."""
    accept = LoadStepping._accept_or_reject

    def fail(stepping, ended):
        tries = np.array(
            [
                0 if press is None else press.tries.index(each)
                for press, each in zip(stepping.press, stepping.tries, strict=True)
            ]
        )
        beyond = ended & (stepping.target > np.array(furthest_mm)[tries])
        stepping.solver.increment.status[beyond] = Status.NEWTON_STALLED
        accept(stepping, ended)

    monkeypatch.setattr(LoadStepping, "_accept_or_reject", fail)
