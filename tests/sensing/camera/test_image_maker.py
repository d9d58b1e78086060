"""The base of renderers: dots need displacements, and are drawn over whatever colours a renderer makes."""

from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

from simgen.errors import InputError
from simgen.sensing.camera.image_maker import ImageMaker
from simgen.sensing.camera.stored_heights import StoredHeights


class Grey(ImageMaker):
    """Makes images of one grey, 10 levels for each mm of height."""

    def __init__(self, heights, dots=None):
        self.heights, self.blur, self.dots = heights, lambda height: height, dots
        self.background, self.files = np.full((4, 6, 3), 7, np.uint8), {}

    def colours(self, height: wp.array) -> wp.array:
        levels = np.repeat(1e4 * height.numpy()[..., None], 3, axis=3)
        return wp.array(np.rint(levels).astype(np.uint8), dtype=wp.uint8, device="cpu")


class Flat:
    """Height maps that a number decides."""

    device = "cpu"

    def __call__(self, source: np.ndarray) -> wp.array:
        return wp.array(np.ones((len(source), 4, 6)) * source[:, None, None], dtype=wp.float32, device="cpu")


def black_at(column: int) -> SimpleNamespace:
    """Dots that blacken one column, further right by the displacement."""

    def draw(image: wp.array, tracks: np.ndarray) -> wp.array:
        drawn = image.numpy()
        for sample, moved in enumerate(tracks):
            drawn[sample, :, column + int(moved)] = 0
        return wp.array(drawn, dtype=wp.uint8, device="cpu")

    return SimpleNamespace(rest=np.zeros(1), tracks=lambda displacement, height: displacement, draw=draw)


def test_colours_follow_heights_and_dots_follow_displacements():
    heights = np.array([1e-3, 3e-3])
    plain, dotted = Grey(Flat()), Grey(Flat(), black_at(1))
    assert plain(heights)[:, 0, 0, 0].tolist() == [10, 30] and (plain.untouched == 7).all()
    images, tracks = dotted.images_and_tracks(heights, np.array([0.0, 2.0]))
    assert tracks.tolist() == [0.0, 2.0]
    assert (images[0, :, 1] == 0).all() and (images[1, :, 3] == 0).all() and (images[1, :, 1] == 30).all()
    assert (dotted.untouched[:, 1] == 0).all() and (dotted.untouched[:, 0] == 7).all()
    assert (dotted.background == 7).all()


def test_dots_on_height_maps_need_displacements():
    stored = object.__new__(StoredHeights)
    with pytest.raises(InputError, match="markers: height maps do not say how dots move"):
        Grey(stored, black_at(0)).images_and_tracks(np.zeros(1))
