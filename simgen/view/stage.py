"""Stage: a three-dimensional view of bodies in the browser, drawn by NiceGUI's three.js."""

import base64
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from nicegui import ui
from nicegui.element import Element

from simgen.view.viewpoint import Viewpoint

THREE_JS = Path(ui.__file__).parent / "elements" / "scene" / "dist"
GLASS = 0.35  # opacity of an indenter, so that the contact below it can be seen


@dataclass
class Body:
    """A triangle mesh on a stage.

    points (v, 3) mm; triangles (f, 3), outward; colours (v, 3) uint8, or None for the one ``colour`` "#rrggbb"; pose
    (4, 4), body -> stage, mm
    """

    points: np.ndarray
    triangles: np.ndarray
    colours: np.ndarray | None = None
    colour: str = "#7d8794"
    opacity: float = 1.0
    pose: np.ndarray | None = None
    visible: bool = True


class Stage(Element, component="stage.js", esm={"nicegui-scene": THREE_JS}):
    """A view of named bodies. Drag to turn, scroll or pinch to zoom, click to choose a place.

    on_place : is called with the name of the body and the point (3,) mm that was clicked
    """

    def __init__(self, on_place: Callable[[str, np.ndarray], None] | None = None):
        super().__init__()
        self._bodies: dict[str, Body] = {}
        self._view: tuple = ()
        self._arrow: tuple = (None, None, 0.0)
        self._ready = False
        self.on("ready", self._send_all)
        if on_place is not None:
            self.on("place", lambda event: on_place(event.args["body"], np.array(event.args["point"])))

    def put(self, name: str, body: Body) -> None:
        """Add a body, or replace the one of this name."""
        self._bodies[name] = body
        self._send(name)

    def move(self, name: str, points: np.ndarray, colours: np.ndarray | None = None) -> None:
        """Move the points (v, 3) mm of a body, and give them new colours (v, 3) uint8."""
        body = self._bodies[name]
        body.points, body.colours = points, body.colours if colours is None else colours
        self._run("move", name, _text(points, "<f4"), None if colours is None else _text(colours, "u1"))

    def pose(self, name: str, pose: np.ndarray) -> None:
        """Move a body as a whole: pose (4, 4), body -> stage, mm."""
        self._bodies[name].pose = pose
        self._run("pose", name, pose.ravel().tolist())

    def show(self, name: str, visible: bool) -> None:
        """Show or hide a body."""
        if name in self._bodies:
            self._bodies[name].visible = visible
            self._run("show", name, visible)

    def remove(self, name: str) -> None:
        """Remove a body, if there is one of this name."""
        if self._bodies.pop(name, None) is not None:
            self._run("remove", name)

    def look(self, viewpoint: Viewpoint, radius: float) -> None:
        """Move the viewer, so that a ball of this radius, mm, is seen. Forget how the user has turned the view."""
        vectors = (viewpoint.towards_viewer, viewpoint.up, viewpoint.target_mm)
        self._view = (*(np.asarray(each).tolist() for each in vectors), radius)
        self._run("look", *self._view)

    def point(self, tip: np.ndarray | None, along: np.ndarray | None = None, length: float = 3.0) -> None:
        """Draw an arrow of this length, mm, that ends at ``tip`` (3,) mm and points along (3,); None removes it."""
        lists = (None if each is None else np.asarray(each).tolist() for each in (tip, along))
        self._arrow = (*lists, length)
        self._run("point", *self._arrow)

    def _run(self, method: str, *arguments) -> None:
        if self._ready:
            self.run_method(method, *arguments)

    def _send(self, name: str) -> None:
        body = self._bodies[name]
        colours = None if body.colours is None else _text(body.colours, "u1")
        arrays = _text(body.points, "<f4"), _text(body.triangles, "<u4"), colours
        self._run("put", name, *arrays, body.colour, body.opacity)
        if body.pose is not None:
            self.pose(name, body.pose)
        if not body.visible:
            self.show(name, False)

    def _send_all(self) -> None:
        """Send everything to a browser that has just made its view."""
        self._ready = True
        for name in self._bodies:
            self._send(name)
        if self._view:
            self._run("look", *self._view)
        self._run("point", *self._arrow)


def _text(array: np.ndarray, kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(array, kind)).decode()
