"""Panel with what a sensor's camera sees of a live press."""

import numpy as np
from nicegui import background_tasks, run, ui

from simgen.view.live_picture import LivePictures
from simgen.view.page_style import data_url, heading, panel

NOTHING = object()


class LiveImage:
    """The camera's image of the depth that is shown.

    Pictures are made beside the server's thread. While one is made, only the newest displacement waits.
    """

    def __init__(self, sensor: str, pictures: LivePictures):
        self._pictures, self._waiting, self._is_busy = pictures, NOTHING, False
        with panel():
            heading(f"Image of the {sensor}")
            self._image = ui.interactive_image().classes("picture")

    def draw(self, displacement: np.ndarray | None) -> None:
        """Draw the image of a displacement (vertex, 3) m, or of the gel at rest, as soon as possible."""
        self._waiting = displacement
        if not self._is_busy:
            self._is_busy = True
            background_tasks.create(self._draw_waiting())

    async def _draw_waiting(self) -> None:
        try:
            while self._waiting is not NOTHING:
                displacement, self._waiting = self._waiting, NOTHING
                picture = await run.io_bound(self._pictures.picture, displacement)
                if not self._image.is_deleted and picture is not None:
                    self._image.set_source(data_url(picture))
        finally:
            self._is_busy = False
