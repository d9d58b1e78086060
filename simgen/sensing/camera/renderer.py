"""Renderer: images of a deformed gel from its surface, the camera, a table of colours and a background."""

from dataclasses import dataclass
from pathlib import Path
from typing import Self

import cv2
import numpy as np
import warp as wp

from simgen.config.choices import DEFAULT_CAMERA
from simgen.config.warp_device import check_device
from simgen.dataset.reader import Dataset
from simgen.dataset.stored_arrays import REST_DEPTH
from simgen.errors import InputError, shown
from simgen.sensing.camera.blur import KERNELS, PYRAMIDS, Blur, pyramid
from simgen.sensing.camera.image_files import read_image
from simgen.sensing.camera.marker_dots import MarkerDots, MarkerTracks
from simgen.sensing.camera.photometric_gel import photometry_of
from simgen.sensing.camera.response import Response
from simgen.sensing.camera.shading import Shading
from simgen.sensing.camera.shadows import Shadows
from simgen.sensing.camera.stored_heights import StoredHeights, check_height_maps
from simgen.sensors.height_map import HeightMaps
from simgen.sensors.marker_layout import MarkerLayout
from simgen.sensors.markers import Markers
from simgen.sensors.pinhole import Pinhole, placed_camera
from simgen.sensors.sensor import Camera
from simgen.sensors.sensor_geometry import sensor_folder
from simgen.sensors.sensor_schema import read_description

AUTO, HEIGHTS = "auto", ("mesh", "solution")
TABLE, BACKGROUND = "optics.npz", "background.png"  # beside a sensor's sensor.yaml, for its default camera


@dataclass(frozen=True)
class Look:
    """Settings of a renderer. Raises `InputError` for an unknown ``blur`` or ``heights``, and for ``dot_mm`` alone.

    table : file of colours in Taxim's layout; by default the camera's own
    background : image of the untouched gel; by default the camera's own
    height, width : px; by default the camera's own
    blur : a name of `simgen.sensing.camera.blur.PYRAMIDS`, by which height maps are smoothed; None leaves them sharp.
        By default those of a mesh are smoothed by ``whole``, and those of the solution stay sharp
    shadows : True dims pixels where the gel itself blocks a light
    heights : source of height maps: "mesh", the stored displacements; or "solution", the height maps that a run has
        stored
    markers : printed dots, as `simgen.sensors.marker_layout.MarkerLayout.of` reads them; None for none
    dot_mm : their diameter; by default that of the sensor's own markers
    camera : a name among ``cameras`` of the sensor.yaml; by default the job's choice
    """

    table: Path | None = None
    background: Path | None = None
    height: int | None = None
    width: int | None = None
    blur: str | None = AUTO
    shadows: bool = False
    camera: str | None = None
    heights: str = "mesh"
    markers: str | None = None
    dot_mm: float | None = None

    def __post_init__(self):
        if self.blur and self.blur not in (*PYRAMIDS, AUTO):
            raise InputError(f"--blur {shown(str(self.blur))!r}: allowed: {', '.join(PYRAMIDS)}")
        if self.heights not in HEIGHTS:
            raise InputError(f"--heights {shown(self.heights)!r}: allowed: {', '.join(HEIGHTS)}")
        if self.dot_mm is not None and self.markers is None:
            raise InputError(f"--dot-mm {self.dot_mm:g}: no --markers; allowed: with --markers")

    @property
    def pyramid(self) -> str | None:
        """The kind of smoothing that applies; None for none."""
        if self.blur == AUTO:
            return "whole" if self.heights == "mesh" else None
        return self.blur


class Renderer:
    """Makes images (sample, height, width, 3) uint8, red first, from what its source of height maps takes.

    heights : `HeightMaps` of a mesh, which take displacements (sample, vertex, 3), m; or `StoredHeights`, which take
        stored height maps (sample, row, column), m
    background : (height, width, 3) uint8, image of the untouched gel, of any size
    kernels, around : px, kernels for the whole map and around the contact, see `camera.blur`; empty for no smoothing
    lights : (3, 3) m, positions of the red, green and blue light, for shadows; None for no shadows
    markers : dots on the coat; None for none
    untouched : (height, width, 3) uint8, the background with its dots

    Raises `InputError` if the camera does not see the gel, or none of the dots.
    """

    def __init__(
        self, heights: HeightMaps | StoredHeights, response: Response, background: np.ndarray,
        kernels: tuple[int, ...] = KERNELS, lights: np.ndarray | None = None, around: tuple[int, ...] = (),
        markers: Markers | None = None,
    ):  # fmt: skip
        self.heights, self.pinhole, self.device = heights, heights.pinhole, heights.device
        pinhole, device = self.pinhole, self.device
        if not self.heights.seen.any():
            raise InputError("camera: the gel is out of its sight; allowed: a camera that looks at it")
        size = (pinhole.width, pinhole.height)
        self.background = background
        if background.shape[:2] != size[::-1]:
            self.background = cv2.resize(background, size, interpolation=cv2.INTER_AREA)
        depth = self.heights.rest_depth
        depth = np.where(self.heights.seen, depth, depth[self.heights.seen].max())
        self.blur = Blur(pinhole.height, pinhole.width, kernels, device, around)
        self.shading = Shading(response, depth / pinhole.focal, self.background, device)
        self.shadows = None if lights is None else Shadows(depth, pinhole, lights, device)
        self.dots = None if markers is None else MarkerDots(markers, heights)
        self.untouched = self.background
        if self.dots:
            image = wp.array(self.background[None], dtype=wp.uint8, device=device)
            self.untouched = self.dots.draw(image, self.dots.rest).numpy()[0]

    @classmethod
    def of_dataset(cls, dataset: Dataset, sensor: str, look: Look = Look(), device: str = "cpu") -> Self:
        """Make the renderer of a dataset's sensor.

        Raises `InputError` if the sensor has no such camera, a file is bad, or this machine lacks ``device``.
        """
        name, camera, folder = camera_of(dataset, sensor, look.camera)
        table, background = optics_files(name)
        own = {"--calibration": (look.table, table), "--background": (look.background, background)}
        files = {option: given or folder / name for option, (given, name) in own.items()}
        for option, file in files.items():
            if own[option][0] is None and not file.exists():
                raise InputError(f"{sensor}: no {file.name} in {folder}; allowed: {option} FILE")
        check_device(device)
        pinhole = Pinhole.of(camera, look.height, look.width)
        surface = [dataset[f"{sensor}/{key}"] for key in ("rest_positions", "surface_triangles")]
        if look.heights == "solution":
            check_height_maps(dataset, sensor, name, pinhole)
            heights = StoredHeights(dataset[f"{sensor}/{REST_DEPTH}"], pinhole, device)
        else:
            heights = HeightMaps.of_mesh(*surface, pinhole, device)
        kernels, around = pyramid(look.pyramid, min(pinhole.width, pinhole.height))
        lights = photometry_of(camera).lights if look.shadows else None
        table, background = Response.load(files["--calibration"]), read_image(files["--background"])
        markers = None
        if look.markers is not None:
            description = read_description(folder / "sensor.yaml")
            markers = Markers.on_surface(MarkerLayout.of(look.markers, description, folder, look.dot_mm), *surface)
        return cls(heights, table, background, kernels, lights, around, markers)

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
        image = self.shading(height)
        if self.shadows is not None:
            self.shadows(image, height)
        return image if tracks is None else self.dots.draw(image, tracks)


def camera_of(dataset: Dataset, sensor: str, name: str | None = None) -> tuple[str, Camera, Path]:
    """Name and camera of a dataset's sensor, and the folder of its model; by default the camera that the job chose.

    Raises `InputError` if there is none.
    """
    if sensor not in dataset.sensors:
        raise InputError(f"{dataset.path}: sensor {sensor!r}: allowed: {', '.join(dataset.sensors)}")
    choice = dataset.job.sensors[sensor]
    folder, name = sensor_folder(dataset.job.locate(choice.model)), name or choice.camera
    return name, placed_camera(read_description(folder / "sensor.yaml"), folder, name), folder


def optics_files(camera: str) -> tuple[str, str]:
    """File names of a camera's table and background in the folder of its sensor."""
    if camera == DEFAULT_CAMERA:
        return TABLE, BACKGROUND
    return tuple(f"{stem}_{camera}.{ending}" for stem, ending in (each.split(".") for each in (TABLE, BACKGROUND)))
