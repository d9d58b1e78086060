"""Surfaces with known depths, and a camera that looks at them."""

from pathlib import Path

import fake
import numpy as np

from simgen.sensing.camera.renderer import Look
from simgen.sensors.pinhole import Pinhole
from simgen.sensors.sensor import Camera

DISTANCE_M = 0.02
SMALL = Look(height=64, width=48)  # images that take little time


def dots_on_ball(file: Path, count: int = 6) -> str:
    """Write a file of dots (at most 6) in two rows of `fake.BALL` that the DIGIT's camera sees; return its path."""
    across = 1e-3 * np.array([[x, z] for x in (-4.5, -3.0) for z in (-1.5, 0.0, 1.5)])
    down = -np.sqrt(fake.RADIUS_M**2 - (across**2).sum(axis=1))
    points = 1e3 * np.column_stack([across[:, 0], down, across[:, 1]])[:count]
    file.write_text("\n".join(["x_mm,y_mm,z_mm", *(",".join(f"{value:.4f}" for value in point) for point in points)]))
    return str(file)


def camera(height: int = 64, width: int = 48) -> Camera:
    """A camera in no special direction, so that mistaken axes show."""
    forward, up = np.array([0.6, 0.0, 0.8]), np.array([0.0, 1.0, 0.0])
    right = np.cross(forward, up)
    position = np.array([0.01, -0.02, 0.03])
    lights = {"red": position + 0.02 * right, "green": position - 0.02 * right, "blue": position + 0.02 * up}
    return Camera(position, forward, up, 60.0, width, height, lights)


def pinhole(height: int = 64, width: int = 48) -> Pinhole:
    return Pinhole.of(camera(height, width))


def in_sensor(view: np.ndarray, of: Pinhole) -> np.ndarray:
    """Points (..., 3) of right, up and depth, m, in the sensor's frame."""
    return of.position + view @ of.axes


def grid(size_m: float, cells: int) -> tuple[np.ndarray, np.ndarray]:
    """Right and up (vertex, 2) m of a square's grid, and its triangles (triangle, 3)."""
    line = np.linspace(-0.5 * size_m, 0.5 * size_m, cells + 1)
    points = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    a, b, c, d = corner, corner + 1, corner + cells + 1, corner + cells + 2
    return points, np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])


def sheet(depth, of: Pinhole, size_m: float = 0.05, cells: int = 300) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (sensor's frame) and triangles of the surface depth(right, up), m."""
    points, triangles = grid(size_m, cells)
    view = np.column_stack([points, np.broadcast_to(depth(*points.T), len(points))])
    return in_sensor(view, of), triangles
