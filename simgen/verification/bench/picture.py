"""Plot of surface error over seconds per depth, with one kind of marker for each element and code."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from simgen.verification.bench.advice import TARGETS_UM
from simgen.verification.bench.measure import Measurement
from simgen.verification.bench.settings import FRICTION, FRICTIONLESS

# By code and element: marker, colour, offset of the edge length beside the marker, label.
FAMILIES = {
    ("simgen", "P2-P1"): ("o", "#1f6f8b", (-4, -5), "simgen P2-P1 (default)"),
    ("simgen", "P1"): ("s", "#c8553d", (-4, -5), "simgen P1"),
    ("NGSolve", "P2-P1, own mesh"): ("^", "#6a4c93", (5, -5), "NGSolve, P2-P1 tetrahedra"),
    ("FElupe", "Q2-Q1-Q1 hexahedra"): ("D", "#b08900", (-4, 5), "FElupe, quadratic hexahedra"),
}
GREY = "#777777"
TITLE = "A sphere pressed 1 mm into a bonded layer of gel, Poisson's ratio 0.499"
NOTE = "numbers at the points:\nedges under the contact, mm\n"


def draw(rows: list[Measurement], path: Path) -> None:
    """Write a PNG. Open markers have friction; crosses have other tolerances on one of the meshes."""
    shown = [row for row in rows if row.converged and row.scene in FRICTION]
    figure, axes = plt.subplots(figsize=(9.4, 5.2), layout="constrained")
    for target in TARGETS_UM:
        axes.axhline(target, color=GREY, linewidth=0.8, linestyle=":", zorder=0)
        axes.text(0.995, target, f"{target:g} µm", color=GREY, fontsize=8.5, ha="right", va="bottom",
                  transform=axes.get_yaxis_transform())  # fmt: skip
    for (code, element), (marker, colour, beside, label) in FAMILIES.items():
        for scene in FRICTION:
            family = [r for r in shown if (r.code, r.element, r.scene, r.changed) == (code, element, scene, "")]
            if family:
                _family(axes, family, marker, colour, beside, label)
    _tolerances(axes, [row for row in shown if row.changed])
    axes.set(xscale="log", yscale="log", xlabel=_time_label(rows[0]), ylabel="RMSE of the displaced surface, µm")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
    axes.margins(x=0.07, y=0.07)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_title(TITLE, fontsize=11, loc="left")
    figure.legend(fontsize=8.5, frameon=False, loc="outside right upper", title=NOTE, title_fontsize=8.5,
                  alignment="left")  # fmt: skip
    figure.savefig(path, dpi=160)
    plt.close(figure)


def _family(axes, family: list[Measurement], marker: str, colour: str, beside: tuple, label: str) -> None:
    """Draw one line from coarse to fine, with edge lengths beside the frictionless points."""
    frictionless, own = family[0].scene == FRICTIONLESS, family[0].code == "simgen"
    family = sorted(family, key=lambda row: -row.edge_mm)
    style = {"markerfacecolor": colour if frictionless else "white", "linestyle": "-" if frictionless else "--"}
    where = "" if not own else ", frictionless" if frictionless else ", friction 0.78"
    x, y = [row.seconds_per_depth for row in family], [row.rmse_um for row in family]
    axes.plot(x, y, color=colour, marker=marker, markersize=6, linewidth=1.2, label=label + where, **style)
    align = {"ha": "right" if beside[0] < 0 else "left", "va": "top" if beside[1] < 0 else "bottom"}
    for row in family if frictionless else []:
        axes.annotate(f"{row.edge_mm:.2g}", (row.seconds_per_depth, row.rmse_um), xytext=beside, fontsize=7.5,
                      color=colour, textcoords="offset points", **align)  # fmt: skip


def _tolerances(axes, rows: list[Measurement]) -> None:
    if rows:
        label = f"simgen P2-P1, {rows[0].edge_mm:g} mm, other tolerances"
        axes.plot([row.seconds_per_depth for row in rows], [row.rmse_um for row in rows], "x", color=GREY,
                  markersize=5, label=label, zorder=1)  # fmt: skip


def _time_label(row: Measurement) -> str:
    return f"seconds{' of one core' if row.device == 'cpu' else ''} per depth ({row.machine})"
