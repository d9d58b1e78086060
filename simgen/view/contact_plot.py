"""Plot of all contacts on the unrolled skin: a click chooses one."""

from collections.abc import Callable

import numpy as np
from nicegui import ui
from nicegui.events import GenericEventArguments

from simgen.view.contact_map import ContactMap
from simgen.view.page_style import heading, panel
from simgen.view.press_table import PressTable

SHOWN, HIDDEN, CHOSEN = "#1769aa", "#d1d5db", "#d1422f"


class ContactPlot:
    """A plot of contacts. Those of filtered presses are blue, others grey; the chosen one is red.

    on_choice : is called with the number of the trajectory that was clicked
    """

    def __init__(self, contacts: ContactMap, table: PressTable, on_choice: Callable[[int], None]):
        self._contacts, self._table, self._on_choice = contacts, table, on_choice
        self._chosen, self._shown = None, np.ones(len(contacts.trajectories), dtype=bool)
        with panel():
            heading(f"Contacts on the {contacts.sensor}")
            self._plot = ui.plotly(self._figure()).classes("plot contacts").style("height: 320px")
        self._plot.on("plotly_click", self._clicked, ["points"])

    def mark(self, trajectory: int) -> None:
        """Mark the contact of a trajectory."""
        if trajectory != self._chosen:
            self._chosen = trajectory
            self._plot.update_figure(self._figure())

    def filter(self, presses: np.ndarray) -> None:
        """Show the contacts of these presses in blue, all others in grey."""
        self._shown = np.isin(self._contacts.trajectories, self._table.trajectory[presses])
        self._plot.update_figure(self._figure())

    def _clicked(self, event: GenericEventArguments) -> None:
        found = [point for point in event.args["points"] if point.get("curveNumber") == 0]
        if found:
            self._on_choice(int(self._contacts.trajectories[found[0]["pointIndex"]]))

    def _figure(self) -> dict:
        points = np.nan_to_num(self._contacts.points_mm, nan=1e9)  # JSON has no NaN
        points = [[None if value > 1e8 else float(value) for value in axis] for axis in points.T]
        numbers = self._contacts.trajectories
        data = [{
            "type": "scatter", "mode": "markers", "x": points[0], "y": points[1],
            "marker": {"size": 7 if len(numbers) < 200 else 4,
                       "color": np.where(self._shown, SHOWN, HIDDEN).tolist()},
            "text": [f"contact {number}" for number in numbers], "hoverinfo": "text",
        }]  # fmt: skip
        for outline in self._contacts.outlines:
            data.append({"type": "scatter", "mode": "lines", "x": outline[:, 0].tolist(), "y": outline[:, 1].tolist(),
                         "line": {"color": "#9ca3af", "width": 1}, "hoverinfo": "skip"})  # fmt: skip
        chosen = numbers == self._chosen
        if chosen.any():
            at = int(np.flatnonzero(chosen)[0])
            data.append({"type": "scatter", "mode": "markers", "x": [points[0][at]], "y": [points[1][at]],
                         "marker": {"size": 11, "color": CHOSEN}, "hoverinfo": "skip"})  # fmt: skip
        across, along = self._contacts.axes
        layout = {
            "margin": {"l": 48, "r": 8, "t": 8, "b": 36}, "showlegend": False, "uirevision": "same",
            "xaxis": {"title": {"text": across}},
            "yaxis": {"title": {"text": along}, "scaleanchor": "x", "autorange": "reversed"},
        }  # fmt: skip
        return {"data": data, "layout": layout, "config": {"displaylogo": False, "displayModeBar": False}}
