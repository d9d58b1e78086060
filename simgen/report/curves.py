"""Curves of force and fluid pressure against depth, with their median and spread."""

import html
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from simgen.dataset.reader import Dataset
from simgen.plotting.html import picture, tiles
from simgen.report.choice import NOTHING_YET

CURVES = 40  # trajectories drawn, at most; the first ones are spread all over the sensor
BAND_FROM = 20  # trajectories, at least, for a band
BAND = (0.1, 0.5, 0.9)  # quantiles


def force_section(dataset: Dataset) -> Iterator[str]:
    values = {sensor: axial_force(dataset, sensor) for sensor in dataset.sensors}
    pressing = dataset.indenter_path.legs == 0
    values = {sensor: own[:, pressing] for sensor, own in values.items()}
    yield from _against_depth(dataset, values, "force, N", "Component along the press axis")


def pressure_section(dataset: Dataset) -> Iterator[str]:
    """Yield nothing unless a fluid fills a cavity."""
    filled = [sensor for sensor in dataset.sensors if dataset.job.sensors[sensor].fluid != "none"]
    pressing = dataset.indenter_path.legs == 0
    values = {sensor: dataset[f"{sensor}/cavity_pressure"][:, pressing] / 1e3 for sensor in filled}
    if filled:
        yield from _against_depth(dataset, values, "pressure, kPa", "Fluid pressure above ambient, at constant volume")


def axial_force(dataset: Dataset, sensor: str) -> np.ndarray:
    """Force (press, depth), N, on the sensor along the press axis; NaN where not reached."""
    axis = dataset["press/contact_pose"][:, :3, 1]
    own = np.einsum("nji,nj->ni", dataset[f"{sensor}/pose"][:, :3, :3], axis)
    return np.einsum("ndi,ni->nd", dataset[f"{sensor}/force"], own)


def band(curves: np.ndarray) -> np.ndarray:
    """Quantiles `BAND` (3, depth) of curves (n, depth), without NaN; NaN if no curve has a value."""
    quantiles = np.full((len(BAND), curves.shape[1]), np.nan)
    some = np.isfinite(curves).any(axis=0)
    quantiles[:, some] = np.nanquantile(curves[:, some], BAND, axis=0)
    return quantiles


def _against_depth(dataset: Dataset, values: Mapping[str, np.ndarray], label: str, about: str) -> Iterator[str]:
    """A picture for each indenter of ``values`` (press, depth) of sensors, from 0 at first touch."""
    if not any(np.isfinite(own).any() for own in values.values()):
        yield NOTHING_YET
        return
    indenter = dataset["press/indenter"]
    count = int(np.bincount(indenter).max())
    lines = f"the first {CURVES} of {count:,} trajectories" if count > CURVES else "trajectories"
    most = " Thick line: median. Shaded: 10 to 90 % of those that reach a depth." if count >= BAND_FROM else ""
    yield f"<p>{html.escape(about)}. Thin lines: {lines}.{most}</p>"
    pictures = []
    for index, name in enumerate(dataset.indenters):
        own = {sensor: curves[indenter == index] for sensor, curves in values.items()}
        figure = draw_curves(dataset["depth"][dataset.indenter_path.legs == 0], own, dataset.sensors)
        axes = figure.axes[0]
        axes.set_title(name, fontsize=10)
        axes.set_ylabel(label)
        pictures.append(picture(figure, f"{label} against depth, {name}"))
    yield tiles(pictures, narrow=True)


def draw_curves(depth: np.ndarray, curves: Mapping[str, np.ndarray], sensors: Sequence[str]) -> Figure:
    """Draw curves (trajectory, depth) of sensors in one pair of axes, depth (depth,) m."""
    figure = Figure(figsize=(3.6, 2.8), layout="constrained")
    axes = figure.subplots()
    depth_mm = np.concatenate([[0.0], depth * 1e3])
    for sensor, own in curves.items():
        own = np.concatenate([np.zeros((len(own), 1)), own], axis=1)
        colour = f"C{sensors.index(sensor)}"
        many = len(own) >= BAND_FROM
        axes.plot(depth_mm, own[:CURVES].T, color=colour, linewidth=0.8, alpha=0.25 if many else 0.7)
        if many:
            low, median, high = band(own)
            axes.fill_between(depth_mm, low, high, color=colour, alpha=0.2, linewidth=0)
            axes.plot(depth_mm, median, color=colour, linewidth=2.0)
        axes.plot([], [], color=colour, label=sensor)
    axes.set_xlabel("depth, mm")
    axes.set_xlim(0.0, depth_mm[-1])
    axes.grid(linewidth=0.3)
    axes.legend(fontsize=8)
    return figure
