"""Simulated presses of a ball at places of a picture, as the camera sees them at any depth.

The ball presses along the normal of the gel under the place. A press with the ball a little aside looks the same a
little aside, so a height map may be shifted by some pixels in place of another press.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np

from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from simgen.sensing.camera.spheres import Circle
from simgen.sensors.pinhole import Pinhole
from simgen.sensors.sensor import Camera, Sensor
from simgen.simulation.height_maps import solution_height_maps
from simgen.simulation.press import Scene, press
from simgen.units import MM_PER_M

DEPTHS, DEEPEST = 7, 7.0 / 15.0  # simulated depths of a ball; the last one, in its radius
NEAR_M = 1e-3  # radius around a place in which the gel's normal is averaged
AT_ONCE = 8  # presses; more are no faster on a core


@dataclass(frozen=True)
class BallPresses:
    """Height maps of presses at several places.

    heights : (place, depth, height, width) int16, in steps
    step_m : m, of the heights
    depths_m : (depth,) m, all multiples of the first one
    rest_depth : (height, width) m, of the untouched gel along the optical axis
    pinhole : the camera
    """

    heights: np.ndarray
    step_m: float
    depths_m: np.ndarray
    rest_depth: np.ndarray
    pinhole: Pinhole

    @classmethod
    def simulate(
        cls, sensor: Sensor, camera: Camera, places: Sequence[Circle], radius_m: float, depths_m: np.ndarray
    ) -> Self:
        """Press a ball into the gel at the middles of circles; steps that fail repeat the last height map."""
        maps = solution_height_maps(sensor.simulation_mesh, camera)[0]
        material = sensor.materials["solid"]
        scene = Scene(sensor, material, batch=min(AT_ONCE, len(places)), outputs=("height_map",), camera=camera)
        poses = np.array([contact_pose(sensor, maps.pinhole, maps.rest_depth, place) for place in places])
        ball = rigid_shape(Kind.SPHERE, radius_m * MM_PER_M)
        results = press(scene, [ball] * len(places), poses, depths_m)
        heights = np.stack([_held(result.height_map, np.isfinite(result.force[:, 0])) for result in results])
        return cls(heights, scene.height_step_m, np.asarray(depths_m), maps.rest_depth, maps.pinhole)

    def height(self, place: int, depth_m: float, right: float = 0.0, down: float = 0.0) -> np.ndarray:
        """Height map (height, width) float32, m, at a depth, shifted by some pixels.

        Between simulated depths, heights follow cubic Hermite polynomials with central differences.
        """
        knots = np.concatenate([[0.0], self.depths_m])
        at = float(np.interp(depth_m, knots, np.arange(len(knots))))
        lower = min(int(at), len(knots) - 2)
        before, below, above, after = (self._knot(place, min(lower + k, len(knots) - 1)) for k in (-1, 0, 1, 2))
        t, first, last = at - lower, 0.5 * (above - before), 0.5 * (after - below)
        bend = first + last - 2.0 * (above - below)
        height = self.step_m * (
            below + t * (first + t * (3.0 * (above - below) - 2.0 * first - last + t * bend))
        )
        if right or down:
            moved = np.array([[1.0, 0.0, right], [0.0, 1.0, down]])
            height = cv2.warpAffine(height, moved, height.shape[::-1], flags=cv2.INTER_CUBIC,
                                    borderMode=cv2.BORDER_REPLICATE)  # fmt: skip
        return np.asarray(height, np.float32)

    def _knot(self, place: int, number: int) -> np.ndarray:
        """Height map at a depth by its number; 0 is no depth. Before it, heights continue without a kink."""
        if number < 0:
            return -self._knot(place, 1)
        return self.heights[place, number - 1].astype(np.float32) if number else np.zeros(self.rest_depth.shape)


def simulated_depths(radius_m: float) -> np.ndarray:
    """Depths (depth,) m at which a ball of this radius is simulated: 0.2 to 1.4 mm for 3 mm."""
    return radius_m * DEEPEST * np.arange(1, DEPTHS + 1) / DEPTHS


def contact_pose(sensor: Sensor, pinhole: Pinhole, rest_depth: np.ndarray, place: Circle) -> np.ndarray:
    """Pose (4, 4) m of an indenter whose tip touches the gel at the middle of a circle, +y against the gel's normal."""
    row, column = (int(np.clip(round(at), 0, size - 1)) for at, size in
                   zip((place.row, place.column), rest_depth.shape, strict=True))  # fmt: skip
    x, y = pinhole.across(np.array(place.row), np.array(place.column))
    point = pinhole.position + np.array([x, y, 1.0]) @ pinhole.axes * rest_depth[row, column]
    surface = sensor.surface
    near = np.linalg.norm(surface.triangles_center - point, axis=1) < NEAR_M
    pose = np.eye(4)
    pose[:3, 1] = -(surface.face_normals[near] * surface.area_faces[near, None]).sum(axis=0)
    pose[:3, 1] /= np.linalg.norm(pose[:3, 1])
    pose[:3, 2] = np.cross([1.0, 0.0, 0.0], pose[:3, 1])
    pose[:3, 2] /= np.linalg.norm(pose[:3, 2])
    pose[:3, 0] = np.cross(pose[:3, 1], pose[:3, 2])
    pose[:3, 3] = point
    return pose


def _held(heights: np.ndarray, reached: np.ndarray) -> np.ndarray:
    """Repeat the last height map of a press that ended early, or a flat one."""
    for step in np.flatnonzero(~reached):
        heights[step] = heights[step - 1] if step else 0
    return heights
