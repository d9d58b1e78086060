"""The image that a sensor's camera sees of a sample, small and quick."""

import io

import numpy as np
from PIL import Image

from simgen.dataset.reader import Dataset
from simgen.errors import InputError
from simgen.sensing.camera.renderer import HEIGHTS, Look, Renderer, camera_of
from simgen.sensing.camera.stored_heights import has_height_maps
from simgen.sensors.sensor import Camera
from simgen.view.drawn_surface import AT_REST

LONGER_SIDE = 320  # px, of an image


class CameraPictures:
    """Images of one sensor of a dataset. The first one takes longer, because it may compile kernels.

    why_not : a sentence if there are no images of this sensor; else empty

    Height maps of the solution are used where the dataset has them, as `simgen render` does.
    """

    def __init__(self, dataset: Dataset, sensor: str):
        self.dataset, self.sensor, self.why_not = dataset, sensor, ""
        self._of_solution = has_height_maps(dataset, sensor, None)
        try:
            self._renderer = self._make(HEIGHTS[1] if self._of_solution else HEIGHTS[0])
            self._of_mesh = self._renderer if not self._of_solution else None
        except InputError as error:
            self.why_not = f"There is no image: {error}"

    def picture(self, press: int, step: int) -> np.ndarray | None:
        """Image (height, width, 3) uint8, red first, at a step or `AT_REST`.

        None without a camera, or if the press did not reach the step. Raises `InputError` if a file cannot be read.
        """
        if self.why_not:
            return None
        if step == AT_REST:
            return self._renderer.untouched
        if self._of_solution:
            source = self.dataset.in_unit(f"{self.sensor}/height_map", press, step)
        else:
            source = self.dataset.displacement(self.sensor, press, step)
        return self._renderer(source[None])[0] if np.isfinite(source).all() else None

    def of_displacement(self, displacement: np.ndarray) -> np.ndarray | None:
        """Image (height, width, 3) uint8 of a displacement (vertex, 3) m; None without a camera."""
        if self.why_not:
            return None
        if self._of_mesh is None:
            self._of_mesh = self._make(HEIGHTS[0])
        return self._of_mesh(displacement[None])[0]

    def _make(self, heights: str) -> Renderer:
        name, camera, _ = camera_of(self.dataset, self.sensor)
        return Renderer.of_dataset(self.dataset, self.sensor, Look(**shrunk(camera), camera=name, heights=heights))


def shrunk(camera: Camera) -> dict[str, int]:
    """Height and width, px, of a camera's small images."""
    factor = LONGER_SIDE / max(camera.height_px, camera.width_px)
    return {"height": round(factor * camera.height_px), "width": round(factor * camera.width_px)}


def as_png(image: np.ndarray) -> bytes:
    """Encode an image (height, width, 3) uint8."""
    data = io.BytesIO()
    Image.fromarray(image).save(data, "PNG", compress_level=1)  # a page on the same machine: quick, not small
    return data.getvalue()
