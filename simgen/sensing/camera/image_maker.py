"""Base of all renderers: images from the surfaces of samples, with printed dots if there are any."""

from abc import ABC, abstractmethod
from functools import cached_property

import numpy as np
import warp as wp

from simgen.errors import InputError
from simgen.sensing.camera.blur import Blur
from simgen.sensing.camera.marker_dots import MarkerDots, MarkerTracks
from simgen.sensing.camera.stored_heights import StoredHeights
from simgen.sensors.height_map import HeightMaps


class ImageMaker(ABC):
    """Makes images (sample, height, width, 3) uint8, red first, from what its source of height maps takes.

    heights : `HeightMaps` of a mesh, which take displacements (sample, vertex, 3), m; or `StoredHeights`, which take
        stored height maps (sample, row, column), m
    blur : smoothing of height maps
    dots : printed dots; None for none
    background : (height, width, 3) uint8, image of the untouched gel without dots
    files : other files of a press's folder, by name
    """

    heights: HeightMaps | StoredHeights
    blur: Blur
    dots: MarkerDots | None
    background: np.ndarray
    files: dict[str, bytes]

    @abstractmethod
    def colours(self, height: wp.array) -> wp.array:
        """Images (sample, height, width, 3) uint8 without dots, of height maps (sample, height, width) m."""

    def __call__(self, source: np.ndarray, displacement: np.ndarray | None = None) -> np.ndarray:
        """Make images (sample, height, width, 3) uint8. ``displacement`` is that of `images_and_tracks`."""
        return self.images_and_tracks(source, displacement)[0]

    def images_and_tracks(
        self, source: np.ndarray, displacement: np.ndarray | None = None
    ) -> tuple[np.ndarray, MarkerTracks | None]:
        """Make images (sample, height, width, 3) uint8, and the tracks of their dots; None without markers.

        displacement : (sample, vertex, 3) m, with which dots move; by default the source itself, if it is of a mesh

        Raises `InputError` for dots on stored height maps alone.
        """
        if self.dots and displacement is None and isinstance(self.heights, StoredHeights):
            raise InputError("markers: height maps do not say how dots move; allowed: displacements beside them")
        heights = self.heights(source)
        tracks = self.tracks(heights, source if displacement is None else displacement)
        return self.image(self.blur(heights), tracks).numpy(), tracks

    def tracks(self, height: wp.array, displacement: np.ndarray) -> MarkerTracks | None:
        """Find the dots under height maps (sample, height, width) m that are not smoothed; None without markers."""
        return self.dots.tracks(displacement, height.numpy()) if self.dots else None

    def image(self, height: wp.array, tracks: MarkerTracks | None = None) -> wp.array:
        """Images (sample, height, width, 3) uint8 of height maps (sample, height, width) m, with dots if given."""
        image = self.colours(height)
        return image if tracks is None else self.dots.draw(image, tracks)

    @cached_property
    def untouched(self) -> np.ndarray:
        """The background (height, width, 3) uint8 with its dots."""
        if self.dots is None:
            return self.background
        image = wp.array(self.background[None], dtype=wp.uint8, device=self.heights.device)
        return self.dots.draw(image, self.dots.rest).numpy()[0]
