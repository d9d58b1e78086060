"""Choice of the presses that a page shows: those that went furthest, and a bounded random sample."""

import numpy as np

from simgen.dataset.reader import Dataset
from simgen.fem.nonlinear.status import has_values

NOTHING_YET = "<p>No press has converged yet.</p>"


def depths_reached(dataset: Dataset, sensor: str) -> np.ndarray:
    """Number (press,) of depths, from the first on, that converged on a sensor."""
    return np.logical_and.accumulate(has_values(dataset[f"{sensor}/status"]), axis=1).sum(axis=1)


def steps_axis(dataset: Dataset) -> tuple[np.ndarray, str]:
    """Values (depth,) of the axis of steps, and its label: depths in mm, or for paths the number of the step."""
    if dataset.indenter_path.is_a_press:
        return dataset["depth"] * 1e3, "depth, mm"
    return np.arange(1, len(dataset["depth"]) + 1), "step of the path"


def step_title(dataset: Dataset, step: int) -> str:
    """Title of a picture of a step: its depth, or for paths its number."""
    number = f"{steps_axis(dataset)[0][step]:g}"
    return f"{number} mm" if dataset.indenter_path.is_a_press else f"step {number}"


def furthest_press(dataset: Dataset, indenter: int | None = None) -> tuple[int, int]:
    """The first press (of an indenter) that reached most depths on all sensors, and their number, 0 if none."""
    reached = np.min([depths_reached(dataset, sensor) for sensor in dataset.sensors], axis=0)
    if indenter is not None:
        reached = np.where(dataset["press/indenter"] == indenter, reached, -1)
    press = int(np.argmax(reached))
    return press, max(int(reached[press]), 0)


def drawn_presses(dataset: Dataset, sensor: str, count: int) -> np.ndarray:
    """At most ``count`` presses (n,) with a converged sample on a sensor, the same number for each indenter.

    They are drawn at random, seeded by the job. Evenly spaced presses would be biased: contacts are a low-discrepancy
    sequence, and every 2^k-th of them lies in one corner.
    """
    random = np.random.default_rng(dataset.job.seed)
    indenter, there = dataset["press/indenter"], depths_reached(dataset, sensor) > 0
    each = max(count // len(dataset.indenters), 1)
    chosen = []
    for index in range(len(dataset.indenters)):
        own = np.flatnonzero(there & (indenter == index))
        chosen.append(random.choice(own, min(each, len(own)), replace=False))
    return np.sort(np.concatenate(chosen))
