"""Curves of force and slip along the path of an indenter that does more than press."""

from collections.abc import Iterator

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from simgen.dataset.reader import Dataset
from simgen.plotting.html import picture, tiles
from simgen.report.choice import NOTHING_YET
from simgen.report.curves import CURVES, axial_force

QUANTITIES = ("normal force, N", "shear force, N", "sliding share of the contact")


def path_section(dataset: Dataset) -> Iterator[str]:
    """Yield nothing if indenters only press."""
    path = dataset.indenter_path
    if path.is_a_press:
        return
    values = {sensor: along_path(dataset, sensor) for sensor in dataset.sensors}
    if not any(np.isfinite(own).any() for own in values.values()):
        yield NOTHING_YET
        return
    ends = np.flatnonzero(np.diff(path.legs, append=path.legs[-1] + 1))
    legs = "; ".join(f"Leg {path.legs[end]} ends at step {end + 1}: {path.label(end)}" for end in ends)
    yield (
        f"<p>Leg 0 is the press. {legs}. Offsets are in the contact frame. Dashed lines: ends of legs. Thin lines: the "
        f"first {CURVES} trajectories.</p>"
    )
    indenter = dataset["press/indenter"]
    pictures = []
    for index, name in enumerate(dataset.indenters):
        own = {sensor: curves[:, indenter == index] for sensor, curves in values.items()}
        pictures.append(picture(_draw(own, ends[:-1] + 1, name), f"forces along the path, {name}"))
    yield tiles(pictures)


def along_path(dataset: Dataset, sensor: str) -> np.ndarray:
    """The `QUANTITIES` (quantity, press, step): N, N and a share; NaN where not reached."""
    shear = np.linalg.norm(dataset[f"{sensor}/shear_force"], axis=2)
    return np.stack([axial_force(dataset, sensor), shear, dataset[f"{sensor}/slip_share"]])


def _draw(values: dict[str, np.ndarray], leg_ends: np.ndarray, name: str) -> Figure:
    figure = Figure(figsize=(4.0, 5.2), layout="constrained")
    figure.suptitle(name, fontsize=10)
    rows = figure.subplots(len(QUANTITIES), 1, sharex=True)
    for axes, quantity, label in zip(rows, range(len(QUANTITIES)), QUANTITIES, strict=True):
        for number, (sensor, own) in enumerate(values.items()):
            curves = own[quantity][:CURVES]
            axes.plot(np.arange(1, curves.shape[1] + 1), curves.T, color=f"C{number}", linewidth=0.8, alpha=0.7)
            axes.plot([], [], color=f"C{number}", label=sensor)
        for end in leg_ends:
            axes.axvline(end, color="0.6", linewidth=0.8, linestyle="--")
        axes.set_ylabel(label, fontsize=8)
        axes.grid(linewidth=0.3)
    rows[0].legend(fontsize=8)
    rows[-1].set_xlabel("step of the path")
    rows[-1].xaxis.set_major_locator(MaxNLocator(integer=True))
    return figure
