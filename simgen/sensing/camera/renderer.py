"""Renderer: images of a deformed gel from its surface, the camera, a table of colours and a background."""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

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
from simgen.sensing.camera.image_maker import ImageMaker
from simgen.sensing.camera.marker_dots import MarkerDots
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
    """Settings of a renderer. Raises `InputError` for a value that is not allowed.

    table : file of colours in Taxim's layout; by default the camera's own
    background : image of the untouched gel; by default the camera's own
    height, width : px; by default the camera's own
    blur : a name of `simgen.sensing.camera.blur.PYRAMIDS`, by which height maps are smoothed; None leaves them sharp.
        By default those of a mesh are smoothed by ``whole``, and those of the solution stay sharp
    shadows : True dims pixels where the gel itself blocks a light
    heights : source of height maps: "mesh", the stored displacements; or "solution", the height maps that a run has
        stored
    vary : seed of optics that are drawn for each press, see `simgen.sensing.camera.varied_renderer`; then
        ``background`` may be a folder of pictures, and there is no ``table``; None for the sensor's own optics
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
    vary: int | None = None
    markers: str | None = None
    dot_mm: float | None = None

    def __post_init__(self):
        if self.blur and self.blur not in (*PYRAMIDS, AUTO):
            raise InputError(f"--blur {shown(str(self.blur))!r}: allowed: {', '.join(PYRAMIDS)}")
        if self.heights not in HEIGHTS:
            raise InputError(f"--heights {shown(self.heights)!r}: allowed: {', '.join(HEIGHTS)}")
        if self.vary is not None and self.vary < 0:
            raise InputError(f"--vary {self.vary}: allowed: 0 or more")
        if self.vary is not None and self.table is not None:
            raise InputError(
                f"--calibration {self.table}: contradicts --vary, which needs no table; allowed: one of them"
            )
        if self.dot_mm is not None and self.markers is None:
            raise InputError(f"--dot-mm {self.dot_mm:g}: no --markers; allowed: with --markers")

    @property
    def pyramid(self) -> str | None:
        """The kind of smoothing that applies; None for none."""
        if self.blur == AUTO:
            return "whole" if self.heights == "mesh" else None
        return self.blur


class Renderer(ImageMaker):
    """Makes images by a table of colours.

    heights : as those of `ImageMaker`
    background : (height, width, 3) uint8, image of the untouched gel, of any size
    kernels, around : px, kernels for the whole map and around the contact, see `camera.blur`; empty for no smoothing
    lights : (3, 3) m, positions of the red, green and blue light, for shadows; None for no shadows
    markers : dots on the coat; None for none

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
        self.files = {}

    @classmethod
    def of_dataset(cls, dataset: Dataset, sensor: str, look: Look = Look(), device: str = "cpu") -> Self:
        """Make the renderer of a dataset's sensor.

        Raises `InputError` if the sensor has no such camera, a file is bad, or this machine lacks ``device``.
        """
        name, camera, folder = camera_of(dataset, sensor, look.camera)
        check_device(device)
        heights = height_source(dataset, sensor, look, name, Pinhole.of(camera, look.height, look.width), device)
        markers = markers_of(dataset, sensor, look, folder)
        return cls._with_optics(sensor, (name, camera, folder), heights, look, markers)

    @classmethod
    def of_mesh(
        cls, sensor: str, folder: Path, rest: np.ndarray, triangles: np.ndarray, look: Look = Look(),
        device: str = "cpu",
    ) -> Self:  # fmt: skip
        """Make the renderer of a sensor's output mesh, without a dataset and without markers.

        sensor : its name, for messages; folder : of its sensor.yaml
        rest, triangles : (vertex, 3) m and outward (triangle, 3) of the mesh's surface

        Raises as `of_dataset`.
        """
        name = look.camera or DEFAULT_CAMERA
        camera = placed_camera(read_description(folder / "sensor.yaml"), folder, name)
        check_device(device)
        heights = HeightMaps.of_mesh(rest, triangles, Pinhole.of(camera, look.height, look.width), device)
        return cls._with_optics(sensor, (name, camera, folder), heights, look, None)

    @classmethod
    def _with_optics(
        cls, sensor: str, model: tuple[str, Camera, Path], heights: HeightMaps | StoredHeights, look: Look,
        markers: Markers | None,
    ) -> Self:  # fmt: skip
        """Make a renderer of height maps, with the colours of a model: its camera's name, camera, and folder."""
        name, camera, folder = model
        table, background = optics_files(name)
        own = {"--calibration": (look.table, table), "--background": (look.background, background)}
        files = {option: given or folder / name for option, (given, name) in own.items()}
        for option, file in files.items():
            if own[option][0] is None and not file.exists():
                raise InputError(f"{sensor}: no {file.name} in {folder}; allowed: {option} FILE")
        pinhole = heights.pinhole
        kernels, around = pyramid(look.pyramid, min(pinhole.width, pinhole.height))
        lights = photometry_of(camera).lights if look.shadows else None
        table, background = Response.load(files["--calibration"]), read_image(files["--background"])
        return cls(heights, table, background, kernels, lights, around, markers)

    def record(self) -> dict[str, Any]:
        """Settings that determine the colours, for JSON."""
        background = hashlib.sha256(self.background.tobytes()).hexdigest()
        return {"background": background, "response": self.shading.response.hash, "shadows": self.shadows is not None}

    def of_press(self, press: int) -> Self:
        """The renderer of a press: itself."""
        return self

    def colours(self, height: wp.array) -> wp.array:
        image = self.shading(height)
        return image if self.shadows is None else self.shadows(image, height)


def camera_of(dataset: Dataset, sensor: str, name: str | None = None) -> tuple[str, Camera, Path]:
    """Name and camera of a dataset's sensor, and the folder of its model; by default the camera that the job chose.

    Raises `InputError` if there is none.
    """
    if sensor not in dataset.sensors:
        raise InputError(f"{dataset.path}: sensor {sensor!r}: allowed: {', '.join(dataset.sensors)}")
    choice = dataset.job.sensors[sensor]
    folder, name = sensor_folder(dataset.job.locate(choice.model)), name or choice.camera
    return name, placed_camera(read_description(folder / "sensor.yaml"), folder, name), folder


def height_source(
    dataset: Dataset, sensor: str, look: Look, camera: str, pinhole: Pinhole, device: str
) -> HeightMaps | StoredHeights:
    """Make the source of height maps. Raises `InputError` if the dataset has none of the camera ``camera``."""
    if look.heights == "solution":
        check_height_maps(dataset, sensor, camera, pinhole)
        return StoredHeights(dataset[f"{sensor}/{REST_DEPTH}"], pinhole, device)
    return HeightMaps.of_mesh(*_output_surface(dataset, sensor), pinhole, device)


def markers_of(dataset: Dataset, sensor: str, look: Look, folder: Path) -> Markers | None:
    """Place the printed dots of a look on a dataset's sensor, whose model lies in ``folder``; None for no dots.

    Raises `InputError` for dots that are not on the gel, and as `MarkerLayout.of`.
    """
    if look.markers is None:
        return None
    description = read_description(folder / "sensor.yaml")
    layout = MarkerLayout.of(look.markers, description, folder, look.dot_mm)
    return Markers.on_surface(layout, *_output_surface(dataset, sensor))


def _output_surface(dataset: Dataset, sensor: str) -> list[np.ndarray]:
    return [dataset[f"{sensor}/{key}"] for key in ("rest_positions", "surface_triangles")]


def optics_files(camera: str) -> tuple[str, str]:
    """File names of a camera's table and background in the folder of its sensor."""
    if camera == DEFAULT_CAMERA:
        return TABLE, BACKGROUND
    return tuple(f"{stem}_{camera}.{ending}" for stem, ending in (each.split(".") for each in (TABLE, BACKGROUND)))
