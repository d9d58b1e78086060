"""Events of a press on a worker process, in the order in which they come: a touch, depths, an end.

``press`` is the number that `simgen.view.press_worker.PressWorker.press` returned.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Ready:
    """The scene of a sensor is ready; so many seconds after it was asked for."""

    sensor: str
    seconds: float


@dataclass(frozen=True, eq=False)
class Touched:
    """The indenter touches the sensor.

    pose : (4, 4) m, indenter frame -> sensor frame at first touch
    """

    press: int
    pose: np.ndarray


@dataclass(frozen=True, eq=False)
class DepthReached:
    """A step of the path has converged. The newest event of a step counts: a second try of a press begins again.

    step : number on the path, from 0
    outputs : one sample of each measured output by name, with the shapes and units of `simgen.config.outputs`
    seconds : since the press was asked for
    """

    press: int
    step: int
    outputs: dict[str, np.ndarray]
    seconds: float


@dataclass(frozen=True)
class PressEnded:
    """A press has ended.

    status : code of `simgen.fem.nonlinear.status.Status`; 0 if it reached all steps. `sentence` explains it
    reached : number of steps that count, from the first; samples of later ones are void
    touch_m : travel along the press axis from the contact to first touch; NaN without a touch
    seconds : since the press was asked for
    """

    press: int
    status: int
    sentence: str
    reached: int
    touch_m: float
    seconds: float


@dataclass(frozen=True)
class Stopped:
    """A press was stopped before its end."""

    press: int


@dataclass(frozen=True)
class Refused:
    """Bad input: the sentence of an `InputError`. Number 0 stands for a preparation."""

    press: int
    sentence: str


@dataclass(frozen=True)
class Lost:
    """The worker process has ended by itself; a new one is needed."""

    sentence: str


Event = Ready | Touched | DepthReached | PressEnded | Stopped | Refused | Lost
