"""Validation report: one self-contained HTML page with rows, plots and tables of each case."""

import html
from collections.abc import Iterator
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from simgen.dataset.provenance import code_version
from simgen.plotting.html import image, picture, table, write_page
from simgen.verification.validate.case import Curve
from simgen.verification.validate.cells import COLUMNS, cells, number
from simgen.verification.validate.record import machine
from simgen.verification.validate.runner import Result, summary

STYLES = {"line": "-", "points": "o", "dashed": "--"}
PLOTS_PER_ROW = 3


def write_validation(results: list[Result], device: str, output: Path) -> None:
    """Write the HTML page of all results."""
    write_page("simgen validate", _lines(results, device), output)


def _lines(results: list[Result], device: str) -> Iterator[str]:
    code, here = code_version(), machine(device)
    commit = (code["commit"] or "installed package")[:12]
    yield "<h1>simgen validate</h1>"
    yield (
        f"<p>{html.escape(summary(results))}. simgen {code['version']} "
        f"({commit}{', with changes' if code['dirty'] else ''}), {html.escape(here['processor'])}, "
        f"{here['cores']} cores, solved on {html.escape(device)}; "
        f"{sum(result.seconds for result in results):.0f} s in all cases together.</p>"
    )
    rows = [[result.case, result.title, f"{result.seconds:.1f} s", _mark(result.verdict)] for result in results]
    yield table(["case", "", "time", "verdict"], rows, raw_last=True)
    for result in results:
        yield from _case(result)


def _case(result: Result) -> Iterator[str]:
    outcome = result.outcome
    yield f"<h2>{html.escape(result.title)}: {_mark(result.verdict)}</h2>"
    for words in filter(None, (result.error, outcome.skipped)):
        yield f"<p>{html.escape(words)}</p>"
    if outcome.rows:
        yield table(COLUMNS, [[*cells(row)[:-1], _mark(row.verdict)] for row in outcome.rows], raw_last=True)
    for note in outcome.notes:
        yield f"<p>{html.escape(note)}</p>"
    if outcome.curves:
        yield picture(draw_curves(outcome.curves), f"plots of {result.case}")
    for shown in outcome.pictures:
        yield f"<h3>{html.escape(shown.title)}</h3>"
        yield image(shown.data, shown.kind, shown.title)
    for evidence in outcome.tables:
        yield f"<h3>{html.escape(evidence.title)}</h3>"
        yield table(evidence.columns, [[number(cell) for cell in row] for row in evidence.rows])


def _mark(verdict: str) -> str:
    kind = {"ok": "ok", "FAIL": "fail", "error": "fail"}.get(verdict, "")
    return f"<span class='{kind}'>{verdict}</span>"


def draw_curves(curves: list[Curve]) -> Figure:
    """Draw one pair of axes for each plot, in the order of the curves."""
    plots = list(dict.fromkeys(curve.plot for curve in curves))
    columns = min(PLOTS_PER_ROW, len(plots))
    rows = -(-len(plots) // columns)
    figure = Figure(figsize=(4.2 * columns, 3.4 * rows), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, plot in zip(grid, plots, strict=False):
        _draw_plot(axes, plot, [curve for curve in curves if curve.plot == plot])
    for axes in grid[len(plots) :]:
        axes.set_axis_off()
    return figure


def _draw_plot(axes: Axes, plot: str, curves: list[Curve]) -> None:
    for curve in curves:
        axes.plot(curve.x, curve.y, STYLES[curve.style], label=curve.label, markersize=4, linewidth=1.2)
    axes.set_title(plot, fontsize=10)
    axes.set_xlabel(curves[0].x_label)
    axes.set_ylabel(curves[0].y_label)
    if curves[0].log:
        axes.set_xscale("log")
        axes.set_yscale("log")
    axes.grid(True, which="major", linewidth=0.3)
    axes.legend(fontsize=8)
