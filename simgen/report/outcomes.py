"""Outcomes of presses: their status by indenter, and the share that reaches each depth."""

from collections.abc import Iterator

import numpy as np
from matplotlib.figure import Figure

from simgen.dataset.reader import Dataset
from simgen.fem.nonlinear.status import NOT_THERE, in_words
from simgen.plotting.html import picture, table, tiles
from simgen.report.choice import depths_reached, steps_axis

NOT_THERE_YET = "Not there yet."


def endings(dataset: Dataset, sensor: str) -> dict[int, np.ndarray]:
    """Number of presses of each indenter (i,), by status at the last depth; -1 is not there yet."""
    last, indenter = dataset[f"{sensor}/status"][:, -1], dataset["press/indenter"]
    count = len(dataset.indenters)
    return {int(code): np.bincount(indenter[last == code], minlength=count) for code in np.unique(last)}


def survival(dataset: Dataset, sensor: str) -> np.ndarray:
    """Share (indenter, depth) of the stored presses that reach each depth; NaN if none is stored."""
    reached, there = depths_reached(dataset, sensor), dataset[f"{sensor}/status"][:, 0] != NOT_THERE
    depths = np.arange(1, len(dataset["depth"]) + 1)
    shares = np.full((len(dataset.indenters), len(depths)), np.nan)
    for index, share in enumerate(shares):
        own = reached[there & (dataset["press/indenter"] == index)]
        if len(own):
            share[:] = (own[:, None] >= depths).mean(axis=0)
    return shares


def outcomes_section(dataset: Dataset) -> Iterator[str]:
    yield "<p>Number of presses of each indenter, by status at the last depth.</p>"
    sentences = {**dataset.attributes["status"], str(NOT_THERE): NOT_THERE_YET}
    rows = []
    for sensor in dataset.sensors:
        for code, counts in endings(dataset, sensor).items():
            words = [in_words(code), sentences.get(str(code), f"Status {code}.")]
            rows.append([sensor, *words, *(f"{n:,}" if n else "" for n in counts)])
    yield table(["sensor", "outcome", "status", *dataset.indenters], rows)
    shares = {sensor: survival(dataset, sensor) for sensor in dataset.sensors}
    known = [share for share in shares.values() if np.isfinite(share).any()]
    if not known:
        return
    if all(np.nanmin(share) == 1.0 for share in known):
        yield "<p>All stored presses reached the last depth.</p>"
        return
    yield (
        "<h3>Share of presses that reach each depth</h3>"
        "<p>Shares of the stored presses. Indenters without a curve reach the last depth in all of them.</p>"
    )
    yield tiles(
        picture(_draw_survival(dataset, sensor, share), f"share of presses that reach each depth on {sensor}")
        for sensor, share in shares.items()
        if (share[:, -1] < 1.0).any()
    )


def _draw_survival(dataset: Dataset, sensor: str, shares: np.ndarray) -> Figure:
    figure = Figure(figsize=(4.0, 3.0), layout="constrained")
    axes = figure.subplots()
    steps, label = steps_axis(dataset)
    for name, share in zip(dataset.indenters, shares, strict=True):
        if share[-1] < 1.0:
            axes.plot(steps, 100.0 * share, ".-", linewidth=1.2, label=name, alpha=0.8)
    axes.set_ylim(-3.0, 103.0)
    axes.set_title(sensor, fontsize=10)
    axes.set_xlabel(label)
    axes.set_ylabel("presses that reach it, %")
    axes.grid(linewidth=0.3)
    axes.legend(fontsize=7)
    return figure
