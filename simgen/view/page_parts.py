"""Parts of pages: style, a panel for a sensor, a plot of curves, and errors as sentences on the page."""

import base64
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from nicegui import ui

from simgen.errors import InputError
from simgen.view.camera_picture import as_png
from simgen.view.colours import SurfaceField, css_gradient
from simgen.view.drawn_indenter import DrawnIndenter
from simgen.view.drawn_surface import DrawnSurface
from simgen.view.stage import GLASS, Body, Stage
from simgen.view.viewpoint import Viewpoint

SEEN = 0.45  # radius of what is seen, over the diagonal of the gel's box
GEL, INDENTER = "gel", "indenter"
CURVE_COLOURS = ("#1769aa", "#c2410c", "#15803d", "#7e22ce", "#b91c1c", "#0e7490")
STYLE = """
.nicegui-content { padding: 10px; gap: 10px; }
.panels { display: grid; width: 100%; gap: 10px; grid-template-columns: repeat(auto-fit, minmax(min(100%, 320px), 1fr)); }
.panel { border: 1px solid #dfe3e8; border-radius: 8px; padding: 8px; background: white; min-width: 0; }
.panel h3 { font-size: 15px; font-weight: 600; line-height: 1.4; margin: 0; }
.stage { width: 100%; height: min(420px, 60vh); border-radius: 6px; }
.legend { height: 10px; flex: 1; border-radius: 5px; }
.row-line { display: flex; width: 100%; gap: 8px; align-items: center; flex-wrap: wrap; }
.small { font-size: 13px; color: #4b5563; }
.fill { flex: 1 1 160px; min-width: 0; }
.plot { width: 100%; height: 260px; }
.words details summary { cursor: pointer; font-size: 13px; }
.words p { margin: 6px 0 2px; font-size: 13px; }
.words td { padding: 1px 8px 1px 0; font-size: 13px; vertical-align: top; }
.bad { color: #b91c1c; }
.good { color: #15803d; }
.picture { width: 100%; max-width: 360px; image-rendering: auto; border-radius: 4px; }
body { background: #eef0f3; }
"""


def begin_page(title: str) -> None:
    """Set style and title of a page."""
    ui.add_css(STYLE)
    ui.page_title(f"{title} - simgen")


@contextmanager
def said_on_the_page() -> Iterator[None]:
    """Show the sentence of an `InputError` on the page, as the command line would print it."""
    try:
        yield
    except InputError as error:
        say(str(error))


def say(sentence: str) -> None:
    """Show the sentence of an error on the page until the user closes it."""
    ui.notify(sentence, type="negative", multi_line=True, timeout=15_000, close_button="Close")


class SensorPanel:
    """A view of one sensor's gel with the indenter, a caption, and a colour scale.

    on_place : is called with a point (3,) mm of the gel that was clicked, in the sensor's frame
    """

    def __init__(self, title: str, on_place: Callable[[np.ndarray], None] | None = None):
        with ui.element("div").classes("panel"):
            with ui.element("div").classes("row-line"):
                ui.html(f"<h3>{title}</h3>", sanitize=False)
                self.caption = ui.label().classes("small fill")
            chosen = None if on_place is None else lambda body, point: on_place(point) if body == GEL else None
            self.stage = Stage(chosen).classes("stage")
            with ui.element("div").classes("row-line small"):
                self._from = ui.label("0")
                self._scale = ui.element("div").classes("legend").style(f"background: {css_gradient()}")
                self._to = ui.label()

    def look(self, viewpoint: Viewpoint, surface: DrawnSurface) -> None:
        """Look at a point halfway between the viewpoint's target and the middle of the gel."""
        low, high = surface.rest_mm.min(axis=0), surface.rest_mm.max(axis=0)
        target = 0.5 * (viewpoint.target_mm + 0.5 * (low + high))
        self.stage.look(replace(viewpoint, target_mm=target), SEEN * float(np.linalg.norm(high - low)))

    def put_gel(self, surface: DrawnSurface) -> None:
        """Draw a gel at rest."""
        self.stage.put(GEL, Body(surface.rest_mm, surface.triangles, np.full(surface.rest_mm.shape, 215, np.uint8)))

    def move_gel(self, positions_mm: np.ndarray, field: SurfaceField) -> None:
        """Move the gel's vertices (v, 3) mm and colour them by a field."""
        self.stage.move(GEL, positions_mm, field.colours)
        self._from.text = "0"
        self._to.text = f"{field.largest:.3g} {field.unit}".strip() + f" ({field.title})"

    def put_indenter(self, drawn: DrawnIndenter | None, pose: np.ndarray | None, visible: bool) -> None:
        """Draw an indenter at a pose (4, 4), mm, indenter frame -> sensor frame; None draws none."""
        if drawn is None or pose is None:
            self.stage.remove(INDENTER)
            return
        body = Body(drawn.vertices_mm, drawn.triangles, opacity=GLASS, pose=pose, visible=visible)
        self.stage.put(INDENTER, body)


class CurvePlot:
    """A plot of curves against depth, with a cursor. ``heading`` is the line above it."""

    def __init__(self, title: str = ""):
        self._cursor: list[dict] = []
        with ui.element("div").classes("panel"):
            with ui.element("div").classes("row-line") as self.heading:
                if title:
                    ui.html(f"<h3>{title}</h3>", sanitize=False)
            self._plot = ui.plotly(self._figure("", "", {}, [])).classes("plot")

    def draw(self, x_label: str, y_label: str, curves: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> None:
        """Draw curves: name -> (x, y), each (n,). Gaps are NaN."""
        self._plot.update_figure(self._figure(x_label, y_label, curves, self._cursor))



    def cursor(self, x: float) -> None:
        """Move the cursor."""
        self._cursor = [{"type": "line", "x0": x, "x1": x, "yref": "paper", "y0": 0, "y1": 1,
                         "line": {"color": "#6b7280", "width": 1, "dash": "dot"}}]  # fmt: skip
        self._plot.figure["layout"]["shapes"] = self._cursor
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


def _numbers(values: np.ndarray) -> list[float | None]:
    """Numbers for JSON, which has no NaN."""
    return [float(value) if np.isfinite(value) else None for value in values]


def copy_text(text: str, about: str) -> None:
    """Copy a text into the clipboard, and say so."""
    ui.clipboard.write(text)
    ui.notify(f"copied {about}", timeout=1500)


def set_link(text: str) -> None:
    """Put a sample's name behind the # of the page's address."""
    ui.run_javascript(f"history.replaceState(null, '', '#' + {json.dumps(text)})")


def data_url(picture: np.ndarray) -> str:
    """Address that holds a picture (height, width, 3) uint8 itself."""
    return "data:image/png;base64," + base64.b64encode(as_png(picture)).decode()
