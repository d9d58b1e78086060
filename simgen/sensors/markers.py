"""Printed dots on a gel's coat: material points of its surface, and how they move with it."""

from dataclasses import dataclass
from typing import Self

import numpy as np
import trimesh

from simgen.errors import InputError
from simgen.geometry.surface import ClosestPoint
from simgen.sensors.height_map import coat
from simgen.sensors.marker_layout import MarkerLayout
from simgen.units import MM

OUTLINE = 32  # points of a dot's outline
# The outline is a polygon. Its corners lie a little outside the circle, so that it has the circle's area.
CORNERS = np.sqrt(2.0 * np.pi / OUTLINE / np.sin(2.0 * np.pi / OUTLINE))
FARTHEST_MM = 1.0  # of a given point from the coat
BENT = 0.25  # of the radius; farthest that a point of the outline may lie from the coat before it is moved onto it
ON_EDGE = 1e-9  # barycentric weight by which a triangle is widened


@dataclass(frozen=True)
class Markers:
    """Dots on the coat: for each its middle, then `OUTLINE` points of its outline, in triangles of the surface.

    rest : (marker, 1 + OUTLINE, 3) m, in the sensor's frame
    corners : (marker, 1 + OUTLINE, 3) vertices of the triangle that holds each point
    weights : (marker, 1 + OUTLINE, 3) of these vertices
    diameter : m
    darkness : share of the light that a dot takes away
    """

    rest: np.ndarray
    corners: np.ndarray
    weights: np.ndarray
    diameter: float
    darkness: float

    @classmethod
    def on_surface(cls, layout: MarkerLayout, rest: np.ndarray, triangles: np.ndarray) -> Self:
        """Print dots on a closed surface of vertices (vertex, 3) m and outward triangles (triangle, 3).

        Only the coat has dots, as the camera ``default`` sees it from within. A dot is the disc in the plane of its
        triangle, moved to the nearest points of the coat. Raises `InputError`, which names the dot, if its middle is
        not on the coat or its outline leaves the coat.
        """
        coated = coat(rest, triangles, layout.camera)
        if not len(coated):
            raise InputError("camera default: sees no coat of the gel; allowed: a camera that looks at it")
        closest = ClosestPoint(rest, coated)
        points = _along_axis(layout, rest[coated]) if layout.along_axis else layout.points
        middle, away, face = closest(points)
        for name, distance in zip(layout.names, away / MM, strict=True):
            if distance > FARTHEST_MM:
                raise InputError(f"{name}: {distance:.3g} mm off the coat; allowed: {FARTHEST_MM:g} mm")
        radius = 0.5 * layout.diameter
        circles = _circles(middle, rest[coated][face], layout.camera.axes[0], CORNERS * radius)
        outline, away, faces = (each.reshape(len(middle), OUTLINE, -1) for each in closest(circles.reshape(-1, 3)))
        for name, distance in zip(layout.names, away.max(axis=(1, 2)), strict=True):
            if distance > BENT * radius:
                raise InputError(f"{name}: the dot of {layout.diameter / MM:g} mm leaves the coat, or the coat bends "
                                 "away under it; allowed: smaller dots, or another place")  # fmt: skip
        points = np.concatenate([middle[:, None], outline], axis=1)
        corners = coated[np.concatenate([face[:, None], faces[..., 0]], axis=1)]
        flat = trimesh.triangles.points_to_barycentric(rest[corners].reshape(-1, 3, 3), points.reshape(-1, 3))
        return cls(points, corners, flat.reshape(points.shape), layout.diameter, layout.darkness)

    def moved(self, displacement: np.ndarray) -> np.ndarray:
        """Points (sample, marker, 1 + OUTLINE, 3) m of dots on a surface with a displacement (sample, vertex, 3) m."""
        return self.rest + np.einsum("mpc,smpcd->smpd", self.weights, displacement[:, self.corners])


def _along_axis(layout: MarkerLayout, triangles: np.ndarray) -> np.ndarray:
    """Move points along the camera's axis onto the nearest (to the camera) of triangles (triangle, 3, 3).

    Raises `InputError` if there is none.
    """
    corners = layout.camera.in_view(triangles)
    a, ab, ac = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    facing = area != 0.0
    a, ab, ac, area = a[facing], ab[facing], ac[facing], area[facing]
    found = []
    for name, point in zip(layout.names, layout.camera.in_view(layout.points), strict=True):
        x, y = (point[:2] - a[:, :2]).T
        b, c = (x * ac[:, 1] - y * ac[:, 0]) / area, (y * ab[:, 0] - x * ab[:, 1]) / area
        hit = (b >= -ON_EDGE) & (c >= -ON_EDGE) & (b + c <= 1.0 + ON_EDGE)
        if not hit.any():
            raise InputError(f"{name}: off the coat; allowed: a grid that ends on it")
        depth = (a[:, 2] + b * ab[:, 2] + c * ac[:, 2])[hit].min()
        found.append(layout.camera.position + np.array([*point[:2], depth]) @ layout.camera.axes)
    return np.array(found)


def _circles(middle: np.ndarray, triangles: np.ndarray, right: np.ndarray, radius: float) -> np.ndarray:
    """Points (marker, OUTLINE, 3) of circles around ``middle`` (marker, 3) in the planes of triangles (marker, 3, 3).

    The first point lies towards ``right``, as far as the plane allows.
    """
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # A plane across `right` has no such direction: there any will do.
    other = np.eye(3)[np.abs(right).argmin()]
    side = np.where(np.abs(normal @ right)[:, None] < 0.9, right, other)
    first = side - np.sum(side * normal, axis=1, keepdims=True) * normal
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(normal, first)
    angle = 2.0 * np.pi * np.arange(OUTLINE) / OUTLINE
    around = np.cos(angle)[:, None] * first[:, None] + np.sin(angle)[:, None] * second[:, None]
    return middle[:, None] + radius * around
