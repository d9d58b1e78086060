"""Pinhole camera: the rays of an image's pixels."""

from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from simgen.config.choices import DEFAULT_CAMERA
from simgen.errors import InputError, shown
from simgen.sensors.sensor import Camera, place_camera
from simgen.sensors.sensor_schema import SensorDescription

MOST_PIXELS = 8192  # largest width and height of an image


@dataclass(frozen=True)
class Pinhole:
    """Rays through the middles of pixels: position + depth * (forward + x right + y up).

    Depth counts along the optical axis, m. Pixel (row, column) has its middle at
    x = (column + 1/2 - width / 2) / focal and y = (height / 2 - row - 1/2) / focal. Rows go down, columns right.

    position : (3,) m, in the sensor's frame
    axes : (3, 3) right, up and forward (rows), in the sensor's frame
    focal : focal length, px
    """

    position: np.ndarray
    axes: np.ndarray
    focal: float
    height: int
    width: int

    @classmethod
    def of(cls, camera: Camera, height: int | None = None, width: int | None = None) -> Self:
        """Make the pinhole of a sensor's camera. Its vertical field of view stays for any ``height`` and ``width``, px.

        Raises `InputError` for a size out of range.
        """
        height = camera.height_px if height is None else height
        width = camera.width_px if width is None else width
        if not (0 < height <= MOST_PIXELS and 0 < width <= MOST_PIXELS):
            raise InputError(f"image of {width} x {height} pixels: allowed: 1 to {MOST_PIXELS} each way")
        right = np.cross(camera.looks_along, camera.up)
        right /= np.linalg.norm(right)
        axes = np.array([right, np.cross(right, camera.looks_along), camera.looks_along])
        focal = 0.5 * height / np.tan(0.5 * np.radians(camera.vertical_field_of_view_deg))
        return cls(camera.position, axes, focal, height, width)

    def record(self) -> dict[str, list[float] | float]:
        """Place and vertical field of view, for JSON."""
        view = 2.0 * np.degrees(np.arctan(0.5 * self.height / self.focal))
        return {"position_m": self.position.tolist(), "axes": self.axes.tolist(), "field_of_view_deg": round(view, 9)}

    def in_view(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) m of the sensor's frame as right, up and depth, m."""
        return (points - self.position) @ self.axes.T

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Columns and rows (..., 2), px, and depths (...), m, of points (..., 3) m of the sensor's frame.

        The middle of a pixel has whole numbers. Points behind the camera have no place in the image: NaN.
        """
        view = self.in_view(points)
        depth = view[..., 2]
        ahead = np.where(depth > 0.0, depth, np.nan)[..., None]
        middle = 0.5 * np.array([self.width, self.height]) - 0.5
        return middle + self.focal * view[..., :2] * [1.0, -1.0] / ahead, depth

    def across(self, rows: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """x (right) and y (up) of the middles of pixels, at a depth of 1."""
        return (columns + 0.5 - 0.5 * self.width) / self.focal, (0.5 * self.height - rows - 0.5) / self.focal


def placed_camera(description: SensorDescription, folder: Path, name: str = DEFAULT_CAMERA) -> Camera:
    """Camera ``name`` of a sensor whose model lies in ``folder``. Raises `InputError` if it has none of this name."""
    cameras = description.cameras
    if not cameras:
        raise InputError(f"{folder / 'sensor.yaml'}: no camera; allowed: a sensor with one, as digit")
    if name not in cameras:
        raise InputError(f"{folder / 'sensor.yaml'}: camera {shown(name)!r}: allowed: {', '.join(cameras)}")
    return place_camera(cameras[name])
