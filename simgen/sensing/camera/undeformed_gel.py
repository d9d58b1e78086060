"""Depth map of the untouched gel, of its true surface without facets."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter

from simgen.config.choices import DEFAULT_CAMERA
from simgen.errors import InputError
from simgen.sensing.camera.response import PUBLISHED_SIZE
from simgen.sensors.height_map import HeightMaps, coat
from simgen.sensors.pinhole import Pinhole, placed_camera
from simgen.sensors.sensor import Camera
from simgen.sensors.sensor_geometry import SensorGeometry

SMOOTH = 0.0125  # of the image's shorter side: 6 of 480 pixels, 0.2 mm on a DIGIT with triangles of 0.5 mm
BEYOND = 4.0  # standard deviations of the smoothing, margin that is rendered around the image


@dataclass(frozen=True)
class UndeformedGel:
    """``depth``: (height, width) m, along the camera's optical axis; infinite beside the gel."""

    camera: Camera
    pinhole: Pinhole
    depth: np.ndarray


def undeformed_gel(
    geometry: SensorGeometry, height: int, width: int, camera_name: str = DEFAULT_CAMERA
) -> UndeformedGel:
    """Make the depth map of a sensor's gel, as one of its cameras sees it.

    Raises `InputError` if it has no such camera, or one of another aspect.
    """
    camera = placed_camera(geometry.description, geometry.folder, camera_name)
    check_aspect(camera, height, width)
    pinhole = Pinhole.of(camera, height, width)
    return UndeformedGel(camera, pinhole, undeformed_depth(geometry, pinhole))


def undeformed_depth(geometry: SensorGeometry, pinhole: Pinhole) -> np.ndarray:
    """Depth (height, width) m of a sensor's gel along the optical axis; infinite beside it.

    Raises `InputError` if the camera does not see it.
    """
    sigma = SMOOTH * min(pinhole.height, pinhole.width)
    margin = int(np.ceil(BEYOND * sigma))
    around = replace(pinhole, height=pinhole.height + 2 * margin, width=pinhole.width + 2 * margin)
    vertices, triangles = (np.asarray(each) for each in (geometry.true.surface.vertices, geometry.true.surface.faces))
    maps = HeightMaps(vertices, coat(vertices, triangles, pinhole), around)
    inside = slice(margin, -margin), slice(margin, -margin)
    if not maps.seen[inside].any():
        raise InputError(f"{geometry.folder / 'sensor.yaml'}: camera: the gel is out of its sight")
    return smooth(maps.rest_depth, sigma)[inside]


def check_aspect(camera: Camera, height: int, width: int) -> None:
    """Raise `InputError` for a picture whose sides have another ratio than the camera's."""
    if abs(height * camera.width_px / (width * camera.height_px) - 1.0) > 0.01:
        own = f"{camera.width_px} x {camera.height_px}"
        raise InputError(f"picture of {width} x {height} pixels: allowed: sides in the ratio of the camera's {own}")


def table_size(camera: Camera) -> tuple[int, int]:
    """Height and width, px, of the camera's image when its longer side is that of published tables."""
    scale = PUBLISHED_SIZE[0] / max(camera.height_px, camera.width_px)
    return round(scale * camera.height_px), round(scale * camera.width_px)


def smooth(depth: np.ndarray, sigma: float) -> np.ndarray:
    """Smooth the finite pixels of a map (height, width) by a Gaussian kernel of ``sigma`` pixels."""
    seen = np.isfinite(depth)
    total = gaussian_filter(np.where(seen, depth, 0.0), sigma, truncate=BEYOND)
    weight = gaussian_filter(seen.astype(float), sigma, truncate=BEYOND)
    return np.where(seen, total / np.where(seen, weight, 1.0), np.inf)
