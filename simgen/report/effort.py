"""Solver effort: iterations, residuals, and the worst certificates of each indenter."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from simgen.dataset.reader import Dataset
from simgen.fem.nonlinear.status import Status, has_values, is_planned_end
from simgen.plotting.html import picture, table, tiles
from simgen.report.choice import NOTHING_YET

BINS = 40  # largest number of bins for whole numbers
PER_DECADE = 10  # bins on a logarithmic scale
SHOWN = ("residual", "contact_error", "force_balance", "min_det_F", "least_det_F", "inverted_elements",
         "stabilised_elements", "damping", "rms_penetration_m", "max_penetration_m", "newton_iterations",
         "krylov_iterations")  # fmt: skip


@dataclass(frozen=True)
class Quantity:
    """A certificate with a histogram. ``tolerance`` names the job's limit; then the scale is logarithmic."""

    key: str
    label: str
    tolerance: str = ""


QUANTITIES = (
    Quantity("newton_iterations", "Newton iterations per sample"),
    Quantity("krylov_iterations", "Krylov iterations per sample"),
    Quantity("residual", "residual / contact force", "residual_tolerance"),
    Quantity("contact_error", "contact error", "contact_tolerance"),
)


def histogram(values: list[np.ndarray], logarithmic: bool) -> tuple[np.ndarray, list[np.ndarray]]:
    """Edges (b + 1,) of bins for all values, at least one, and the counts (b,) of each array (n,).

    Logarithmic bins fill whole decades and leave out values up to 0. The edges of other bins lie between integers.
    """
    everything = np.concatenate(values)
    if logarithmic:
        exponents = np.log10(everything[everything > 0]) if (everything > 0).any() else np.zeros(1)
        low, high = np.floor(exponents.min()), np.floor(exponents.max()) + 1
        edges = 10.0 ** (np.arange(low * PER_DECADE, high * PER_DECADE + 1) / PER_DECADE)
    else:
        width = max(int(np.ceil((everything.max() - everything.min() + 1) / BINS)), 1)
        edges = np.arange(everything.min(), everything.max() + 1 + width, width) - 0.5
    return edges, [np.histogram(own, edges)[0] for own in values]


def effort_section(dataset: Dataset) -> Iterator[str]:
    stored = {sensor: _converged(dataset, sensor) for sensor in dataset.sensors}
    if not any(len(own["residual"]) for own in stored.values()):
        yield NOTHING_YET
        return
    yield "<p>Converged samples. Dashed lines: tolerances of the job.</p>"
    yield tiles(
        picture(_draw_histogram(dataset, quantity, [own[quantity.key] for own in stored.values()]), quantity.label)
        for quantity in QUANTITIES
    )
    yield "<h3>Worst certificates of each indenter</h3>"
    yield _certificates(dataset)


def _converged(dataset: Dataset, sensor: str) -> dict[str, np.ndarray]:
    good = has_values(dataset[f"{sensor}/status"])
    return {each.key: dataset[f"{sensor}/certificate/{each.key}"][good] for each in QUANTITIES}


def _draw_histogram(dataset: Dataset, quantity: Quantity, values: list[np.ndarray]) -> Figure:
    edges, counts = histogram(values, logarithmic=bool(quantity.tolerance))
    figure = Figure(figsize=(4.0, 2.3), layout="constrained")
    axes = figure.subplots()
    for sensor, own in zip(dataset.sensors, counts, strict=True):
        axes.stairs(own, edges, fill=True, alpha=0.45, label=sensor)
    if quantity.tolerance:
        axes.set_xscale("log")
        axes.axvline(getattr(dataset.job.solver, quantity.tolerance), color="black", linewidth=0.8, linestyle="--")
    axes.set_xlabel(quantity.label)
    axes.set_ylabel("samples")
    axes.legend(fontsize=8)
    return figure


def _stabilisation(values: dict[str, np.ndarray]) -> tuple[str, str]:
    """Stabilised elements, mean and most, and share of damped samples; empty if an older dataset lacks them."""
    if "damping" not in values:
        return "", ""
    stabilised = values["stabilised_elements"]
    return f"{stabilised.mean():.0f}, {stabilised.max()}", f"{np.mean(values['damping'] > 0):.1%}"


def _certificates(dataset: Dataset) -> str:
    header = ["sensor", "indenter", "converged", "converged, inverted", "residual", "contact error", "force balance",
              "least det F", "inverted elements", "elements stabilised (mean, max)", "samples damped",
              "penetration rms, max (um)", "Newton, Krylov iterations (mean)"]  # fmt: skip
    rows = []
    for sensor in dataset.sensors:
        status = dataset[f"{sensor}/status"]
        paths = {key: f"{sensor}/certificate/{key}" for key in SHOWN}
        stored = {key: dataset[path] for key, path in paths.items() if path in dataset.arrays}  # older ones lack some
        for index, name in enumerate(dataset.indenters):
            own = (dataset["press/indenter"] == index)[:, None]
            good = own & has_values(status)
            converged = f"{np.count_nonzero(good)} of {np.count_nonzero(own & ~is_planned_end(status))}"
            inverted = np.count_nonzero(own & (status == Status.INSIDE_OUT))
            if not good.any():
                rows.append([sensor, name, converged] + [""] * (len(header) - 3))
                continue
            values = {key: array[good] for key, array in stored.items()}
            rows.append([
                sensor, name, converged, f"{inverted}",
                f"{values['residual'].max():.1e}", f"{values['contact_error'].max():.1e}",
                f"{values['force_balance'].max():.1e}", f"{values.get('least_det_F', values['min_det_F']).min():.3f}",
                f"{values['inverted_elements'].max()}",
                *_stabilisation(values),
                ", ".join(f"{values[f'{k}_penetration_m'].max() * 1e6:.1f}" for k in ("rms", "max")),
                f"{values['newton_iterations'].mean():.1f}, {values['krylov_iterations'].mean():.0f}",
            ])  # fmt: skip
    return table(header, rows)
