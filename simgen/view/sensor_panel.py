"""Panel of a sensor: its gel with the indenter in three dimensions, and the scale of its colours."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from nicegui import ui

from simgen.view.colours import SurfaceField, css_gradient
from simgen.view.drawn_indenter import DrawnIndenter
from simgen.view.drawn_surface import DrawnSurface
from simgen.view.page_style import heading
from simgen.view.page_style import panel as box
from simgen.view.stage import GLASS, Body, Stage
from simgen.view.viewpoint import Viewpoint

SEEN = 0.45  # radius of what is seen, over the diagonal of the gel's box
GEL, INDENTER = "gel", "indenter"


class SensorPanel:
    """A view of one sensor's gel with the indenter, a caption, and a colour scale.

    on_place : is called with the point (3,) mm of the gel that was clicked: its place at rest, in the sensor's frame
    """

    def __init__(self, title: str, on_place: Callable[[np.ndarray], None] | None = None):
        self._rest_mm = self._moved_mm = np.zeros((1, 3), np.float32)
        with box():
            with ui.element("div").classes("row-line"):
                heading(title)
                self.caption = ui.label().classes("small fill")
            chosen = lambda body, point: on_place(self._at_rest(point)) if body == GEL else None  # noqa: E731
            self.stage = Stage(on_place and chosen).classes("stage")
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
        self._rest_mm = self._moved_mm = surface.rest_mm
        self.stage.put(GEL, Body(surface.rest_mm, surface.triangles, np.full(surface.rest_mm.shape, 215, np.uint8)))

    def move_gel(self, positions_mm: np.ndarray, field: SurfaceField) -> None:
        """Move the gel's vertices (v, 3) mm and colour them by a field."""
        self._moved_mm = positions_mm
        self.stage.move(GEL, positions_mm, field.colours)
        self._from.text = "0"
        self._to.text = f"{field.largest:.3g} {field.unit}".strip() + f" ({field.title})"

    def _at_rest(self, point_mm: np.ndarray) -> np.ndarray:
        """Where a point (3,) mm of the drawn gel is at rest: the nearest vertex tells how far it has moved."""
        nearest = np.linalg.norm(self._moved_mm - point_mm, axis=1).argmin()
        return point_mm - (self._moved_mm - self._rest_mm)[nearest]

    def put_indenter(self, drawn: DrawnIndenter | None, pose: np.ndarray | None, visible: bool) -> None:
        """Draw an indenter at a pose (4, 4), mm, indenter frame -> sensor frame; None draws none."""
        if drawn is None or pose is None:
            self.stage.remove(INDENTER)
            return
        body = Body(drawn.vertices_mm, drawn.triangles, opacity=GLASS, pose=pose, visible=visible)
        self.stage.put(INDENTER, body)
