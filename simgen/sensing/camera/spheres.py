"""Spheres pressed into a gel, as its camera sees them. Tables of colours are fitted to them.

A sphere of known radius touches the gel in a circle. Inside the circle the coat follows the sphere, whatever the gel is
made of. So its tilt is known at every pixel.
"""

from dataclasses import dataclass

import numpy as np

from simgen.errors import InputError
from simgen.sensors.pinhole import Pinhole


@dataclass(frozen=True)
class Circle:
    """Contact circle in the image: column and row of its middle, and its radius, px.

    The middle of the first pixel is column 0, row 0.
    """

    column: float
    row: float
    radius: float


@dataclass(frozen=True)
class Patch:
    """Pixels (n,) of a contact, and depth (n,) m of the sphere there, along the optical axis."""

    rows: np.ndarray
    columns: np.ndarray
    depth: np.ndarray


def sphere_in(circle: Circle, radius_m: float, rest_depth: np.ndarray, pinhole: Pinhole) -> Patch:
    """Pixels where a sphere through a contact circle is nearer to the camera than the surface at rest.

    rest_depth : (height, width) m

    The sphere's middle lies beyond the surface, on the normal at the circle's middle. Raises `InputError` if the circle
    is not on the surface, or larger than the sphere.
    """
    height, width = rest_depth.shape
    row, column = round(circle.row), round(circle.column)
    around = slice(row - 1, row + 2), slice(column - 1, column + 2)
    if not (1 <= row < height - 1 and 1 <= column < width - 1 and np.isfinite(rest_depth[around]).all()):
        where = f"column {circle.column:.4g}, row {circle.row:.4g}"
        raise InputError(f"circle at {where} of {width} x {height} pixels: allowed: its middle on the gel")
    at, normal = _tangent_plane(rest_depth, pinhole, row, column)
    ray = np.array([*pinhole.across(circle.row, circle.column), 1.0])
    at = ray * (at @ normal) / (ray @ normal)
    share = circle.radius * at[2] / pinhole.focal / radius_m
    if not 0.0 < share < 1.0:
        raise InputError(
            f"circle of {circle.radius:.4g} pixels: {share:.3g} of the sphere's radius; allowed: between 0 and 1"
        )
    middle = at - normal * radius_m * np.sqrt(1.0 - share * share)

    reach = int(np.ceil(circle.radius)) + 1
    rows, columns = np.mgrid[max(row - reach, 0) : min(row + reach + 1, height),
                             max(column - reach, 0) : min(column + reach + 1, width)].reshape(2, -1)  # fmt: skip
    inside = (rows - circle.row) ** 2 + (columns - circle.column) ** 2 < circle.radius**2
    rows, columns = rows[inside], columns[inside]
    x, y = pinhole.across(rows, columns)
    ray = np.stack([x, y, np.ones(len(x))], axis=1)
    # |depth * ray - middle| = radius: the smaller root
    square, along = np.einsum("ni,ni->n", ray, ray), ray @ middle
    below = along**2 - square * (middle @ middle - radius_m**2)
    met = below > 0.0
    rows, columns, depth = rows[met], columns[met], (along[met] - np.sqrt(below[met])) / square[met]
    nearer = (depth < rest_depth[rows, columns]) & np.isfinite(rest_depth[rows, columns])
    return Patch(rows[nearer], columns[nearer], depth[nearer])


def _tangent_plane(depth: np.ndarray, pinhole: Pinhole, row: int, column: int) -> tuple[np.ndarray, np.ndarray]:
    """A point of the surface (right, up, depth), m, and its unit normal towards the camera."""
    rows = np.array([row, row, row, row - 1, row + 1])
    columns = np.array([column, column - 1, column + 1, column, column])
    x, y = pinhole.across(rows, columns)
    points = np.stack([x, y, np.ones(5)], axis=1) * depth[rows, columns][:, None]
    normal = np.cross(points[2] - points[1], points[3] - points[4])
    normal *= -np.sign(normal[2]) / np.linalg.norm(normal)
    return points[0], normal
