"""Renderer with drawn optics: each press is seen by a sensor of its own."""

import hashlib
import json
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np
import warp as wp

from simgen.config.warp_device import check_device
from simgen.dataset.reader import Dataset
from simgen.errors import InputError
from simgen.sensing.camera.blur import Blur, pyramid
from simgen.sensing.camera.direct_shading import DirectShading, Illumination
from simgen.sensing.camera.drawn_optics import DrawnOptics, OpticsRanges
from simgen.sensing.camera.image_files import read_image
from simgen.sensing.camera.image_maker import ImageMaker
from simgen.sensing.camera.marker_dots import MarkerDots
from simgen.sensing.camera.photometric_gel import photometry_of
from simgen.sensing.camera.renderer import Look, Renderer, camera_of, height_source, markers_of
from simgen.sensing.camera.shadows import Shadows
from simgen.sensing.camera.stored_heights import StoredHeights
from simgen.sensing.camera.undeformed_gel import undeformed_depth
from simgen.sensors.height_map import HeightMaps
from simgen.sensors.markers import Markers
from simgen.sensors.pinhole import Pinhole
from simgen.sensors.sensor_geometry import load_geometry

RANGES = OpticsRanges()
OPTICS = "optics.json"  # drawn values, in the folder of a press
PICTURES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff"}


class PressRenderer(ImageMaker):
    """Makes images of one press under drawn optics. Its background has no noise."""

    def __init__(
        self, source: "VariedRenderer", shading: DirectShading, gain: np.ndarray, background: np.ndarray,
        optics: DrawnOptics, lights: np.ndarray, picture: str | None,
    ):  # fmt: skip
        self.heights, self.blur, self.dots = source.heights, source.blur, source.dots
        self.background = np.rint(background).astype(np.uint8)
        self._shading, self._gain, self._levels, self._optics = shading, gain, background, optics
        self._shadows = Shadows(source.coat_depth, source.pinhole, lights, source.device) if source.shadows else None
        record = optics.record() | {"lights_m": lights.tolist()} | ({} if picture is None else {"background": picture})
        self.files = {OPTICS: json.dumps(record, indent=1).encode()}

    def colours(self, height: wp.array) -> wp.array:
        reaching = None if self._shadows is None else self._shadows.reaching(height)
        return self._shading.image(height, self._gain, self._levels, self._optics.noise, self._optics.seed, reaching)


class VariedRenderer:
    """Makes the renderer of each press, with optics that a seed and the number of the press decide.

    heights : as those of `Renderer`
    gel_depth : (height, width) m, smooth depth of the gel at rest; infinite beside it
    lights : (3, 3) m, positions of the sensor's own red, green and blue light, in the sensor's frame
    pictures : files of untouched gels, which take the place of drawn backgrounds; empty for drawn ones
    shadows : True dims pixels where the gel itself blocks a drawn light
    markers : dots on the coat; None for none

    Raises `InputError` if the camera does not see the gel, or none of the dots.
    """

    def __init__(
        self, heights: HeightMaps | StoredHeights, gel_depth: np.ndarray, lights: np.ndarray, seed: int, blur: Blur,
        pictures: tuple[Path, ...] = (), shadows: bool = False, ranges: OpticsRanges = RANGES,
        markers: Markers | None = None,
    ):  # fmt: skip
        self.heights, self.pinhole, self.device = heights, heights.pinhole, heights.device
        if not (heights.seen.any() and np.isfinite(gel_depth).any()):
            raise InputError("camera: the gel is out of its sight; allowed: a camera that looks at it")
        self.coat_depth = np.where(heights.seen, heights.rest_depth, heights.rest_depth[heights.seen].max())
        self.blur, self.shadows, self.seed, self.ranges = blur, shadows, seed, ranges
        self._gel_depth, self._lights, self._pictures = gel_depth, lights, pictures
        self.dots = None if markers is None else MarkerDots(markers, heights)
        self._greatest = float(gel_depth[np.isfinite(gel_depth)].max())

    @classmethod
    def of_dataset(cls, dataset: Dataset, sensor: str, look: Look, device: str = "cpu") -> Self:
        """Make the renderer of a dataset's sensor.

        Raises `InputError` if the sensor has no such camera, a file is bad, or this machine lacks ``device``.
        """
        name, camera, folder = camera_of(dataset, sensor, look.camera)
        check_device(device)
        pinhole = Pinhole.of(camera, look.height, look.width)
        heights = height_source(dataset, sensor, look, name, pinhole, device)
        kernels, around = pyramid(look.pyramid, min(pinhole.width, pinhole.height))
        blur = Blur(pinhole.height, pinhole.width, kernels, device, around)
        depth = undeformed_depth(load_geometry(str(folder)), pinhole)
        pictures = () if look.background is None else pictures_in(Path(look.background))
        lights, markers = photometry_of(camera).lights, markers_of(dataset, sensor, look, folder)
        return cls(heights, depth, lights, look.vary, blur, pictures, look.shadows, RANGES, markers)

    def record(self) -> dict[str, Any]:
        """Settings that determine the optics, for JSON."""
        digest = hashlib.sha256()
        for file in self._pictures:
            digest.update(file.read_bytes())
        backgrounds = f"{len(self._pictures)} pictures, sha256 {digest.hexdigest()}" if self._pictures else "drawn"
        return {"vary": self.seed, "ranges": self.ranges.record(), "backgrounds": backgrounds, "shadows": self.shadows}

    def of_press(self, press: int) -> PressRenderer:
        """Make the renderer of a press. Raises `InputError` if a picture is bad or a drawn light misses the gel."""
        optics = DrawnOptics.draw(self.seed, press, self.ranges)
        lights = optics.lights(self._lights, self.pinhole, self._greatest)
        beams = optics.beams(self.pinhole.height, self.pinhole.width)
        illumination = Illumination(lights, optics.crosstalk, beams)
        shading = DirectShading(self._gel_depth, self.pinhole, illumination, self.device)
        gain, background = shading.exposure(optics.level, optics.ambient)
        picture = None
        if self._pictures:
            picture = self._pictures[optics.seed % len(self._pictures)]
            background = self._resized(read_image(picture)).astype(np.float32)
        return PressRenderer(self, shading, gain, background, optics, lights, picture and picture.name)

    def _resized(self, picture: np.ndarray) -> np.ndarray:
        size = (self.pinhole.width, self.pinhole.height)
        return picture if picture.shape[1::-1] == size else cv2.resize(picture, size, interpolation=cv2.INTER_AREA)


def pictures_in(path: Path) -> tuple[Path, ...]:
    """A picture, or the pictures of a folder in the order of their names.

    Raises `InputError` if the folder has none, or one that cannot be read.
    """
    if not path.is_dir():
        read_image(path)
        return (path,)
    found = tuple(sorted(file for file in path.iterdir() if file.suffix.lower() in PICTURES))
    if not found:
        raise InputError(f"{path}: no picture in this folder; allowed: files that end in {', '.join(sorted(PICTURES))}")
    for file in found:  # now, and not when a press draws it, after images have been written
        read_image(file)
    return found


def renderer_of(dataset: Dataset, sensor: str, look: Look, device: str = "cpu") -> Renderer | VariedRenderer:
    """Make the renderer that a look asks for. Raises `InputError` as its ``of_dataset``."""
    kind = Renderer if look.vary is None else VariedRenderer
    return kind.of_dataset(dataset, sensor, look, device)
