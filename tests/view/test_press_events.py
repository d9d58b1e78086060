"""Events travel between processes."""

import pickle
from dataclasses import FrozenInstanceError
from typing import get_args

import numpy as np
import pytest

from simgen.view.press_events import DepthReached, Event, Lost, PressEnded, Ready, Refused, Stopped, Touched

EVENTS = [
    Ready("digit", 1.0),
    Touched(1, np.eye(4)),
    DepthReached(1, 0, {"force": np.ones(3)}, 0.2),
    PressEnded(1, 0, "Converged.", 1, 1e-5, 0.3),
    Stopped(1),
    Refused(0, "no"),
    Lost("gone"),
]


def test_these_are_all_events():
    assert {type(event) for event in EVENTS} == {*get_args(Event)}


@pytest.mark.parametrize("event", EVENTS, ids=lambda event: type(event).__name__)
def test_an_event_travels_and_does_not_change(event):
    there = pickle.loads(pickle.dumps(event))
    assert type(there) is type(event)
    for name, value in vars(event).items():
        np.testing.assert_equal(getattr(there, name), value)
    with pytest.raises(FrozenInstanceError):
        setattr(event, next(iter(vars(event))), None)
