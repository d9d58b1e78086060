"""Estimated errors of the mesh: histograms and maps by sensor, and a table by indenter and depth."""

from collections.abc import Iterator

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from simgen.dataset.reader import Dataset
from simgen.dataset.touchable import touchable_surface
from simgen.fem.nonlinear.status import has_values
from simgen.plotting.html import picture, table, tiles
from simgen.report.choice import step_title
from simgen.report.coverage import contacts_on
from simgen.report.effort import histogram
from simgen.report.maps import draw_map
from simgen.units import UM_PER_M

SURFACE, FORCE = "surface_error_estimate_m", "force_error_estimate"
STEPS_SHOWN = 3  # at the end, in the middle and at a quarter of the path


def estimated_errors_section(dataset: Dataset) -> Iterator[str]:
    """Lines of HTML about the estimates of all sensors; none without estimates."""
    with_surface = [sensor for sensor in dataset.sensors if f"{sensor}/{SURFACE}" in dataset.arrays]
    with_force = [sensor for sensor in dataset.sensors if f"{sensor}/{FORCE}" in dataset.arrays]
    if not with_surface and not with_force:
        return
    yield (
        "<p>Surface: root mean square over the vertices that move by 10 um or more, from the same presses on the next "
        "coarser mesh. Force: share of the force, from the energy of the strain's error.</p>"
    )
    kinds = ((with_surface, SURFACE, UM_PER_M, "surface, um"), (with_force, FORCE, 100.0, "force, %"))
    kinds = [kind for kind in kinds if kind[0]]
    yield tiles(picture(_draw(dataset, *kind), f"estimated error, {kind[-1]}") for kind in kinds)
    step = (len(dataset["depth"]) - 1) // 2
    yield f"<h3>By place, median over the indenters at {step_title(dataset, step)} (grey: not touchable)</h3>"
    yield tiles(_maps(dataset, step, kinds))
    yield "<p>Median and worst of the converged samples:</p>"
    for kind in kinds:
        yield _by_indenter(dataset, *kind)


def _maps(dataset: Dataset, step: int, kinds: list[tuple]) -> Iterator[str]:
    """Maps in which each touchable point has the estimate of its nearest contact."""
    for sensors, key, scale, label in kinds:
        for sensor in sensors:
            values, contacts = _by_contact(dataset, sensor, key, scale)[:, step], contacts_on(dataset, sensor)
            values = values[contacts.trajectories]
            known = np.isfinite(values)
            if known.any():
                surface = touchable_surface(dataset, sensor)
                _, nearest = cKDTree(contacts.points[known]).query(surface.vertices[surface.points])
                drawn = draw_map(surface, values[known][nearest], sensor, label, largest=values[known].max())
                yield picture(drawn, f"estimated error of the {label}, by place on {sensor}")


def _by_contact(dataset: Dataset, sensor: str, key: str, scale: float) -> np.ndarray:
    """Median (trajectory, step) over the converged presses of each contact; NaN without one."""
    values, trajectory = _of_samples(dataset, sensor, key, scale), dataset["press/trajectory"]
    medians = np.full((trajectory.max() + 1, values.shape[1]), np.nan)
    for each in np.unique(trajectory):
        own = values[trajectory == each]
        some = np.isfinite(own).any(axis=0)
        medians[each, some] = np.nanmedian(own[:, some], axis=0)
    return medians


def _of_samples(dataset: Dataset, sensor: str, key: str, scale: float) -> np.ndarray:
    """Sizes (press, step) of the estimates; NaN where there is none or the press failed."""
    values = scale * np.abs(dataset[f"{sensor}/{key}"])
    return np.where(has_values(dataset[f"{sensor}/status"]), values, np.nan)


def _draw(dataset: Dataset, sensors: list[str], key: str, scale: float, label: str) -> Figure:
    values = [_of_samples(dataset, sensor, key, scale) for sensor in sensors]
    values = [own[np.isfinite(own)] for own in values]
    edges, counts = histogram(values, logarithmic=True)
    figure = Figure(figsize=(4.0, 2.3), layout="constrained")
    axes = figure.subplots()
    for sensor, own in zip(sensors, counts, strict=True):
        axes.stairs(own, edges, fill=True, alpha=0.45, label=sensor)
    axes.set_xscale("log")
    axes.set_xlabel(f"estimated error of the {label}")
    axes.set_ylabel("samples")
    axes.legend(fontsize=8)
    return figure


def _by_indenter(dataset: Dataset, sensors: list[str], key: str, scale: float, label: str) -> str:
    """Median and worst estimate of each indenter at some steps."""
    last = len(dataset["depth"]) - 1
    steps = sorted({last // 4, last // 2, last})[-STEPS_SHOWN:]
    rows = []
    for sensor in sensors:
        values = _of_samples(dataset, sensor, key, scale)
        for index, name in enumerate(dataset.indenters):
            own = values[dataset["press/indenter"] == index]
            rows.append([sensor, name, *(_median_and_worst(own[:, step]) for step in steps)])
    return table(["sensor", "indenter", *(f"{label}, {step_title(dataset, step)}" for step in steps)], rows)


def _median_and_worst(values: np.ndarray) -> str:
    known = values[np.isfinite(values)]
    return f"{np.median(known):.1f}, {known.max():.1f}" if len(known) else ""
