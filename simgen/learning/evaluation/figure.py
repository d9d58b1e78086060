"""Figure of errors over the depth of a press, with a panel for each task."""

import math
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from simgen.errors import writing
from simgen.learning.evaluation.error_tables import Entry
from simgen.learning.evaluation.floor import Floor
from simgen.learning.evaluation.metrics import MeshErrors

WIDTH_MM, HEIGHT_MM, MARGIN_MM = 86.0, 72.0, 12.0  # of a panel
INCH_MM = 25.4
COLUMNS = 3
DEPTH = "depth_mm"
BASELINE = {"color": "0.55", "linewidth": 1.0}
STYLES = ("solid", "dotted", "dashed")  # lines of baselines
FLOOR = {"color": "black", "linewidth": 1.0, "linestyle": "dashdot"}
NETWORK = {"linewidth": 1.8, "marker": ".", "markersize": 4}


def write_figure(file: Path, entries: Sequence[Entry]) -> None:
    """Write the figure unless it is empty. Raises `InputError` if the file cannot be written."""
    figure = draw(entries)
    if figure is not None:
        with writing(file):
            figure.savefig(file, dpi=150)


def draw(entries: Sequence[Entry]) -> Figure | None:
    """Draw root mean square errors of meshes; None if no entry has them by depth."""
    tasks: dict[str, list[Entry]] = {}
    for entry in entries:
        if isinstance(entry.errors, MeshErrors | Floor) and DEPTH in entry.labels:
            tasks.setdefault(entry.task, []).append(entry)
    if not tasks:
        return None
    columns = min(COLUMNS, len(tasks))
    lines = math.ceil(len(tasks) / columns)
    figure = Figure(figsize=(columns * WIDTH_MM / INCH_MM, (lines * HEIGHT_MM + MARGIN_MM) / INCH_MM), layout="tight")
    panels = figure.subplots(lines, columns, squeeze=False).ravel()
    for axes, (task, own) in zip(panels, tasks.items(), strict=False):
        _panel(axes, task, own)
    for axes in panels[len(tasks) :]:
        axes.remove()
    return figure


def _panel(axes: Axes, task: str, entries: Sequence[Entry]) -> None:
    """Draw a line for each model: networks in colour, baselines in grey, the floor in black."""
    styles = cycle(STYLES)
    for entry in entries:
        groups = entry.errors.groups(entry.labels[DEPTH])
        errors = [each.summary()["rmse_um"].mean or math.nan for each in groups.values()]  # 0 has no logarithm
        if isinstance(entry.errors, Floor):
            style = FLOOR
        else:
            style = BASELINE | {"linestyle": next(styles)} if entry.baseline else NETWORK
        axes.plot(list(groups), errors, label=entry.model, **style)
    axes.set_yscale("log")
    axes.set_title(task, fontsize=9)
    axes.set_xlabel("depth, mm", fontsize=8)
    axes.set_ylabel("RMSE, um", fontsize=8)
    axes.tick_params(labelsize=7)
    axes.grid(alpha=0.3, which="major")
    axes.legend(fontsize=6.5, frameon=False)
