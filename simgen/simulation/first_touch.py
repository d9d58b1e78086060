"""First touch of indenters that move along their axes towards the surface at rest.

Conservative advancement (sphere tracing): a shape that moves by its least distance to the surface cannot overlap it.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from simgen.fem.device import launch_kernel, read
from simgen.fem.elements.element import TRIANGLE_EDGES, barycentric_p2
from simgen.fem.nonlinear.status import Status
from simgen.fem.precision import mat33, real, vec3
from simgen.geometry.rigid_shape import shape_array
from simgen.geometry.signed_distance import RigidShape, distance

wp.set_module_options({"enable_backward": False})

RETREAT_MM = 10.0  # the approach starts this far behind the given pose and ends as far beyond it
ACCURACY_MM = 1e-6  # a shape nearer than this touches
CLOSE_MM = 0.02  # faces this near at the coarse first touch are sampled densely
COARSE, FINE = 10, 80  # subdivisions of a face's edges
THREADS = {"cpu": 1, "cuda": 64}  # per densely sampled face, which has 3,321 points


@wp.kernel
def approach_kernel(
    nodes: wp.array(dtype=vec3),
    faces: wp.array2d(dtype=wp.int32),
    points: wp.array2d(dtype=wp.float64),
    shapes: wp.array(dtype=RigidShape),
    shape_of: wp.array(dtype=wp.int32),
    rotation: wp.array(dtype=mat33),
    origin: wp.array(dtype=vec3),
    known: wp.array2d(dtype=wp.float64),
    limit: wp.array(dtype=wp.float64),
    threads: wp.int32,
    # outputs
    of_face_out: wp.array2d(dtype=wp.float64),
    distance_out: wp.array(dtype=wp.float64),
):
    """Compute each shape's least distance from each face and from all faces; points (point, nodes): shape functions.

    Faces with a ``known`` distance (face, press) beyond the limit are skipped. Several threads may share the points of
    a face; then only the distance from all faces is written.
    """
    f, first, i = wp.tid()
    if known[f, i] > limit[i]:
        return
    least = real(wp.inf)
    for q in range(first, points.shape[0], threads):
        position = vec3()
        for a in range(faces.shape[1]):
            position += points[q, a] * nodes[faces[f, a]]
        local = wp.transpose(rotation[i]) * (position - origin[i])
        least = wp.min(least, distance(shapes[shape_of[i]], local))
    if threads == 1:
        of_face_out[f, i] = least
    wp.atomic_min(distance_out, i, least)


def dense_shapes(subdivisions: int, linear: bool) -> np.ndarray:
    """Shape functions (points, 6 or 3) at regular points of a quadratic or linear face."""
    i, j = np.meshgrid(np.arange(subdivisions + 1), np.arange(subdivisions + 1), indexing="ij")
    inside = i + j <= subdivisions
    barycentric = np.stack([i[inside], j[inside], subdivisions - i[inside] - j[inside]], axis=1) / subdivisions
    return barycentric if linear else barycentric_p2(barycentric, TRIANGLE_EDGES)


class _Approach:
    """Shapes that approach a surface: nodes (n, 3) mm, faces (f, 6 or 3), poses (b, 4, 4) mm."""

    def __init__(self, nodes, faces, shapes: list[RigidShape], poses: np.ndarray, device):
        self.poses, self.device, b = poses, device, len(poses)
        linear = faces.shape[1] == 3
        self._surface = [
            wp.array(nodes, dtype=vec3, device=device),
            wp.array(np.ascontiguousarray(faces, dtype=np.int32), dtype=wp.int32, device=device),
        ]
        distinct = list({id(shape): shape for shape in shapes}.values())
        number = {id(shape): i for i, shape in enumerate(distinct)}
        self._shapes = shape_array(distinct, device)
        self._shape_of = wp.array([number[id(shape)] for shape in shapes], dtype=wp.int32, device=device)
        self._rotation = wp.array(np.ascontiguousarray(poses[:, :3, :3]), dtype=mat33, device=device)
        self._points = [wp.array(dense_shapes(n, linear), dtype=wp.float64, device=device) for n in (COARSE, FINE)]
        self._nothing, self._of_face, self._ignored = (
            wp.zeros((len(faces), b), dtype=wp.float64, device=device) for _ in range(3)
        )

    def _distance(self, travel: np.ndarray, moving: np.ndarray, fine: bool, limit: np.ndarray) -> np.ndarray:
        """Least distance (b,) mm from the surface after ``travel`` (b,) mm, of the shapes ``moving`` (b,) bool.

        Fine sampling skips faces whose coarse distance is above ``limit`` (b,) mm.
        """
        known, of_face = (self._of_face, self._ignored) if fine else (self._nothing, self._of_face)
        origin = self.poses[:, :3, 3] + travel[:, None] * self.poses[:, :3, 1]
        least = wp.full(len(self.poses), np.inf, dtype=wp.float64, device=self.device)
        limit = wp.array(np.where(moving, limit, -np.inf), dtype=wp.float64, device=self.device)
        inputs = [*self._surface, self._points[fine], self._shapes, self._shape_of, self._rotation]
        threads = THREADS["cpu" if least.device.is_cpu else "cuda"] if fine else 1
        inputs += [wp.array(origin, dtype=vec3, device=self.device), known, limit, threads]
        dim, outputs = (known.shape[0], threads, known.shape[1]), [of_face, least]
        launch_kernel(approach_kernel, dim=dim, inputs=inputs, outputs=outputs, device=self.device)
        [least] = read(least)
        return least

    def _advance(self, travel: np.ndarray, moving: np.ndarray, fine: bool, limit) -> tuple[np.ndarray, np.ndarray]:
        """Move the shapes ``moving`` (b,) bool along +y until they touch; returns travel and last distance, (b,) mm."""
        travel, moving, least = travel.copy(), moving.copy(), np.full(len(travel), np.inf)
        while moving.any():
            least = np.where(moving, self._distance(travel, moving, fine, limit), least)
            moving &= (least >= ACCURACY_MM) & (travel <= RETREAT_MM)
            travel[moving] += least[moving]
        return travel, least

    def touch(self, reach: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Travel (b,) mm, Status (b,), and number of faces (b,) nearer than ``reach`` mm at first touch."""
        start, everywhere = np.full(len(self.poses), -RETREAT_MM), np.full(len(self.poses), np.inf)
        travel, least = self._advance(start, np.ones(len(self.poses), dtype=bool), False, everywhere)
        status = np.full(len(self.poses), int(Status.CONVERGED))
        status[travel > RETREAT_MM] = Status.NEVER_TOUCHES
        status[travel == start] = Status.STARTS_INSIDE
        touches = status == Status.CONVERGED
        [of_face] = read(self._of_face)
        near = (of_face < reach).sum(axis=0)
        travel, _ = self._advance(np.maximum(travel - CLOSE_MM, start), touches, True, least + CLOSE_MM)
        return np.where(touches, travel, 0.0), status, near


def first_touch(
    nodes, faces, shapes: list[RigidShape], poses: np.ndarray, device="cpu", batch: int = 1, reach: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the first touch of shapes that move along their +y axes from poses (b, 4, 4) mm.

    Returns the travel (b,) mm, a Status (b,), and the number of faces (b,) nearer than ``reach`` mm at first touch,
    which a press of that depth could meet.

    The surface has nodes (n, 3) mm and faces (f, 6 or 3). All faces are sampled coarsely, then those next to the touch
    densely, for ``batch`` shapes at a time.
    """
    found = [
        _Approach(nodes, faces, shapes[i : i + batch], poses[i : i + batch], device).touch(reach)
        for i in range(0, len(shapes), batch)
    ]
    travel, status, near = (np.concatenate(each) for each in zip(*found, strict=True))
    return travel, status, near
