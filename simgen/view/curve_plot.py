"""Plot of curves against depth, with a cursor."""

from collections.abc import Mapping

import numpy as np
from nicegui import ui

from simgen.view.page_style import heading, panel

CURVE_COLOURS = ("#1769aa", "#c2410c", "#15803d", "#7e22ce", "#b91c1c", "#0e7490")


class CurvePlot:
    """A plot of curves against depth, with a cursor. ``heading`` is the line above it."""

    def __init__(self, title: str = ""):
        self._cursor: list[dict] = []
        with panel():
            with ui.element("div").classes("row-line") as self.heading:
                if title:
                    heading(title)
            self._plot = ui.plotly(self._figure("", "", {}, [])).classes("plot")

    def draw(
        self,
        x_label: str,
        y_label: str,
        curves: Mapping[str, tuple[np.ndarray, np.ndarray]],
        cursor: float | None = None,
        x_end: float | None = None,
    ) -> None:
        """Draw curves: name -> (x, y), each (n,). Gaps are NaN. The axis ends at ``x_end``, or with the curves."""
        if cursor is not None:
            self._cursor = _line_at(cursor)
        figure = self._figure(x_label, y_label, curves, self._cursor)
        if x_end is not None:
            figure["layout"]["xaxis"]["range"] = [0.0, 1.03 * x_end]
        self._plot.update_figure(figure)

    def cursor(self, x: float) -> None:
        """Move the cursor."""
        self._cursor = self._plot.figure["layout"]["shapes"] = _line_at(x)
        self._plot.update()

    @staticmethod
    def _figure(x_label: str, y_label: str, curves: Mapping, shapes: list) -> dict:
        data = [
            {"x": _numbers(x), "y": _numbers(y), "name": name, "mode": "lines+markers", "marker": {"size": 4},
             "line": {"color": CURVE_COLOURS[i % len(CURVE_COLOURS)]}}
            for i, (name, (x, y)) in enumerate(curves.items())
        ]  # fmt: skip
        layout = {
            "margin": {"l": 48, "r": 8, "t": 8, "b": 36}, "shapes": shapes, "showlegend": True,
            "legend": {"x": 0.02, "y": 0.98}, "uirevision": "same",
            "xaxis": {"title": {"text": x_label}}, "yaxis": {"title": {"text": y_label}},
        }  # fmt: skip
        return {"data": data, "layout": layout, "config": {"displaylogo": False, "displayModeBar": False}}


def _line_at(x: float) -> list[dict]:
    """Shapes of a figure: a vertical line."""
    look = {"color": "#6b7280", "width": 1, "dash": "dot"}
    return [{"type": "line", "x0": x, "x1": x, "yref": "paper", "y0": 0, "y1": 1, "line": look}]


def _numbers(values: np.ndarray) -> list[float | None]:
    """Numbers for JSON, which has no NaN."""
    return [float(value) if np.isfinite(value) else None for value in values]
