"""Jobs of live presses on the coarse DIGIT, and the waiting for events of a worker."""

import time

from simgen.config.job_schema import Job
from simgen.view.live_job import PressChoices, base_job, live_job
from simgen.view.press_events import DepthReached, Event, Lost, PressEnded, Ready, Refused, Stopped
from simgen.view.press_worker import PressWorker

ENDS = (Ready, PressEnded, Stopped, Refused, Lost)
LONGEST_S = 300.0  # kernels may compile first


def job_at(x_mm: float = -6.0, arc_mm: float = 0.0, depths: int = 3, sensors=("digit",), **choices) -> Job:
    """A press of the ring to 0.3 mm."""
    contact = {"x_mm": x_mm, "arc_mm": arc_mm, "tilt_deg": 3.0, "azimuth_deg": 40.0, "roll_deg": 20.0}
    chosen = {"depth_mm": 0.3, "depths": depths, **choices}
    return live_job(base_job(sensors, ["ring_7mm"]), PressChoices(contact, "ring_7mm", **chosen))


def events_until(worker: PressWorker, kinds=ENDS, longest_s: float = LONGEST_S) -> list[Event]:
    """Poll until an event of these kinds arrives; returns all events up to then."""
    events, end = [], time.perf_counter() + longest_s
    while not any(isinstance(each, kinds) for each in events):
        assert time.perf_counter() < end, f"no {kinds} among {events}"
        time.sleep(0.005)
        events += worker.poll()
    return events


def depths_of(events: list[Event]) -> list[DepthReached]:
    return [each for each in events if isinstance(each, DepthReached)]
