"""Measure the time of live presses: from the request to the first depth and to the last, and from a stop to its end.

    python benchmarks/live_press.py --output live_press.json

A ring presses to 1 mm at ten depths, each time at another place. Sensors of a pair press beside each other, on a worker
each. Scenes are ready, and kernels compiled; the press of another friction makes a new scene.
"""

import time
from collections.abc import Sequence
from statistics import median

from record import arguments, write

from simgen.config.job_schema import Job
from simgen.view.live_job import PressChoices, base_job, live_job
from simgen.view.press_events import DepthReached, Event, PressEnded, Ready, Stopped
from simgen.view.press_worker import PressWorker

INDENTER, DEPTHS = "ring_7mm", 10


def job_at(base: Job, number: int, **choices) -> Job:
    contact = {"x_mm": -6.0 - 0.4 * number, "arc_mm": 0.5}
    return live_job(base, PressChoices(contact, INDENTER, 1.0, DEPTHS, **choices))


def events_until(workers: Sequence[PressWorker], kind: type[Event]) -> list[list[Event]]:
    """Events of each worker, up to one of this kind. Raises RuntimeError if a press is refused."""
    events: list[list[Event]] = [[] for _ in workers]
    while not all(any(isinstance(each, kind) for each in own) for own in events):
        time.sleep(0.002)
        for worker, own in zip(workers, events, strict=True):
            own += worker.poll()
            if failed := [each for each in own if hasattr(each, "sentence") and not isinstance(each, PressEnded)]:
                raise RuntimeError(failed[0].sentence)
    return events


def presses(workers: dict[str, PressWorker], jobs: Sequence[Job]) -> list[dict]:
    """Press each job on all workers at once; one row for each sensor, with times of its own events, s."""
    first, last = {sensor: [] for sensor in workers}, {sensor: [] for sensor in workers}
    for job in jobs:
        for sensor, worker in workers.items():
            worker.press(job, sensor)
        for sensor, events in zip(workers, events_until(list(workers.values()), PressEnded), strict=True):
            depths = [each for each in events if isinstance(each, DepthReached)]
            assert len(depths) == DEPTHS
            first[sensor].append(depths[0].seconds)
            last[sensor].append(depths[-1].seconds)
    return [
        {"sensor": sensor, "presses": len(jobs)}
        | {"first depth": summary(first[sensor]), "all depths": summary(last[sensor])}
        for sensor in workers
    ]


def stops(worker: PressWorker, sensor: str, jobs: Sequence[Job]) -> dict:
    """Stop each press after its first depth."""
    seconds = []
    for job in jobs:
        worker.press(job, sensor)
        events_until([worker], DepthReached)
        begin = time.perf_counter()
        worker.stop()
        events_until([worker], Stopped)
        seconds.append(time.perf_counter() - begin)
    return {"sensor": sensor, "presses": len(jobs), "stop": summary(seconds)}


def summary(seconds: Sequence[float]) -> dict[str, float]:
    return {"median": round(median(seconds), 3), "least": round(min(seconds), 3), "most": round(max(seconds), 3)}


def main():
    parser = arguments(__doc__, "live_press.json")
    parser.add_argument("--presses", type=int, default=7)
    asked = parser.parse_args()
    alone, pair = base_job(["digit"], [INDENTER]), base_job(["digit", "biotac"], [INDENTER])
    numbers, begin = range(asked.presses), time.perf_counter()
    workers = {sensor: PressWorker(asked.device) for sensor in pair.sensors}
    for sensor, worker in workers.items():
        worker.prepare(pair, sensor)
    events_until(list(workers.values()), Ready)
    rows = [{"what": "start of both workers", "seconds": round(time.perf_counter() - begin, 2)}]
    digit = {"digit": workers["digit"]}
    coarse = [job_at(alone, number) for number in numbers]
    frictions = [job_at(alone, n, materials={"digit": {"friction": 0.2 + 0.05 * n}}) for n in numbers]
    fine = [job_at(alone, number, mesh="default") for number in numbers]
    rows += [{"what": "alone"} | row for row in presses(digit, coarse)]
    rows += [{"what": "pair"} | row for row in presses(workers, [job_at(pair, number) for number in numbers])]
    rows += [{"what": "another friction each time"} | row for row in presses(digit, frictions)]
    rows += [{"what": "stopped"} | stops(digit["digit"], "digit", coarse)]
    presses(digit, fine[:1])  # makes the scene
    rows += [{"what": "default mesh"} | row for row in presses(digit, fine)]
    for worker in workers.values():
        worker.close()
    write(asked, rows)


if __name__ == "__main__":
    main()
