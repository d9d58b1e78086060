"""Panels of what networks predict for a sample: electrodes, predicted gels and images, and how far they are off."""

from collections.abc import Callable

import numpy as np
import trimesh
from nicegui import run, ui

from simgen.view.colours import colours_of
from simgen.view.curve_plot import CURVE_COLOURS
from simgen.view.page_style import data_url, heading, panel
from simgen.view.predictions import Predicted, Predictions
from simgen.view.sensor_panel import SensorPanel
from simgen.view.stage import Body
from simgen.view.viewpoint import top_viewpoint

ELECTRODES, DOT_MM = "electrodes", 0.45
PAD_NORMAL = np.array([0.0, -1.0, 0.0])


class PredictedPanels:
    """Predictions of the sample that is shown, beside the truth."""

    def __init__(self, predictions: Predictions):
        self.predictions = predictions
        source, target = self.predictions.source, self.predictions.target
        names = ", ".join(self.predictions.networks)
        with panel().style("width: 100%"):
            heading(f"Predicted by {names}")
            self._said = ui.label().classes("small")
            self._shows = ui.toggle(
                {"displacement": "predicted displacement", "difference": "distance from the truth"},
                value="displacement", on_change=self._colour,
            ).props("dense no-caps").classes("shows-difference")  # fmt: skip
        self._predicted: Predicted | None = None
        with ui.element("div").classes("panels") as self._panels:
            self._gels = {name: SensorPanel(f"{name}, predicted") for name in (source, target)}
            with panel():
                heading(f"Electrodes of the {source}")
                self._electrodes = ui.plotly({"data": [], "layout": {}}).classes("plot electrodes")
            with panel():
                heading(f"Image of the {target}, predicted; difference")
                with ui.element("div").classes("row-line"):
                    self._image = ui.interactive_image().style("width: 45%")
                    self._difference = ui.interactive_image().style("width: 45%")
        for name, gel in self._gels.items():
            surface = self.predictions.surfaces[name].surface
            gel.put_gel(surface)
            gel.look(top_viewpoint(PAD_NORMAL, surface.rest_mm.mean(axis=0)), surface)

    async def draw(self, press: int, step: int, is_old: Callable[[], bool]) -> None:
        """Predict a sample and draw it, unless ``is_old`` says that another sample is shown by then."""
        why_not = self.predictions.why_not(press, step)
        self._said.text = why_not
        self._panels.set_visibility(not why_not)
        if why_not:
            return
        predicted = await run.io_bound(self.predictions.of_sample, press, step)
        if is_old() or predicted is None:
            return
        self._predicted = predicted
        self._colour()
        self._electrodes.update_figure(electrode_figure(predicted.signals, predicted.at_rest))
        for image, picture in ((self._image, predicted.image), (self._difference, predicted.difference)):
            image.set_visibility(picture is not None)
            if picture is not None:
                image.set_source(data_url(picture))

    def _colour(self) -> None:
        if self._predicted is None:
            return
        own = self._predicted
        skin = own.surfaces[self.predictions.source].positions_mm[self.predictions.above_electrodes]
        dots = electrode_dots(skin, own.signals - own.at_rest)
        self._gels[self.predictions.source].stage.put(ELECTRODES, dots)
        for name, gel in self._gels.items():
            own = self._predicted.surfaces[name]
            gel.move_gel(own.positions_mm, getattr(own, self._shows.value))
            gel.caption.text = f"off by {own.rmse_um:.3g} um (root mean square)"


def electrode_dots(places_mm: np.ndarray, changes: np.ndarray) -> Body:
    """Balls at places (electrode, 3) mm, coloured by the size of the changes (electrode,) of the signals."""
    ball = trimesh.creation.icosphere(1, DOT_MM)
    colours = colours_of(np.abs(changes), float(np.abs(changes).max()))
    points = (places_mm[:, None] + ball.vertices).reshape(-1, 3)
    triangles = len(ball.vertices) * np.arange(len(places_mm))[:, None, None] + ball.faces
    return Body(points, triangles.reshape(-1, 3), np.repeat(colours, len(ball.vertices), axis=0))


def electrode_figure(signals: np.ndarray, at_rest: np.ndarray) -> dict:
    """A bar for each electrode: its signal (electrode,), V, and its signal without contact."""
    numbers = list(range(1, len(signals) + 1))
    change = np.abs(signals - at_rest)
    colours = [f"rgb({r},{g},{b})" for r, g, b in colours_of(change, float(change.max())).tolist()]
    data = [
        {"type": "bar", "x": numbers, "y": signals.tolist(), "marker": {"color": colours}, "name": "signal"},
        {"type": "scatter", "mode": "markers", "x": numbers, "y": at_rest.tolist(), "name": "without contact",
         "marker": {"symbol": "line-ew-open", "size": 12, "color": CURVE_COLOURS[0]}},
    ]  # fmt: skip
    low, high = (float(each) for each in (min(signals.min(), at_rest.min()), max(signals.max(), at_rest.max())))
    room = 0.1 * (high - low) or 0.1
    layout = {
        "margin": {"l": 48, "r": 8, "t": 8, "b": 36}, "showlegend": False,
        "xaxis": {"title": {"text": "electrode"}},
        "yaxis": {"title": {"text": "V"}, "range": [low - room, high + room]},
    }  # fmt: skip
    return {"data": data, "layout": layout, "config": {"displaylogo": False, "displayModeBar": False}}
