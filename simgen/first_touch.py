"""Where an indenter that moves along its axis first meets the rest surface.

Conservative advancement (sphere tracing): a shape moved by its least distance to the surface cannot yet overlap it.
"""

from __future__ import annotations

import numpy as np

from .distance import RigidShape
from .fem.element import TRIANGLE_EDGES, barycentric_p2
from .fem.newton import Status
from .shape import signed_distance

RETREAT_MM = 10.0  # the approach starts this far behind the given pose and ends as far beyond it
ACCURACY_MM = 1e-6


def face_points(nodes: np.ndarray, faces: np.ndarray, subdivisions: int) -> np.ndarray:
    """Regular points on quadratic (f, 6) or linear (f, 3) faces: (f, points, 3)."""
    i, j = np.meshgrid(np.arange(subdivisions + 1), np.arange(subdivisions + 1), indexing="ij")
    inside = i + j <= subdivisions
    barycentric = np.stack([i[inside], j[inside], subdivisions - i[inside] - j[inside]], axis=1) / subdivisions
    shapes = barycentric_p2(barycentric, TRIANGLE_EDGES) if faces.shape[1] == 6 else barycentric
    return np.einsum("qa,fai->fqi", shapes, nodes[faces])


def _advance(points: np.ndarray, shape: RigidShape, pose: np.ndarray, travel: float) -> tuple[float, np.ndarray]:
    """Move the shape along its +y until it touches the points (k, 3); returns the travel and the last distances."""
    local = (points - pose[:3, 3]) @ pose[:3, :3]
    axis = np.array([0.0, 1.0, 0.0])
    while True:
        distance = signed_distance(shape, local - travel * axis)[0]
        nearest = float(distance.min())
        if nearest < ACCURACY_MM or travel > RETREAT_MM:
            return travel, distance
        travel += nearest


def first_touch(nodes, faces, shapes: list[RigidShape], poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Travel (b,) mm along each shape's +y axis from its pose (b, 4, 4) mm to first touch, and a Status (b,).

    The surface is sampled on every face, then densely on the faces next to the touch.
    """
    travel, status = np.zeros(len(shapes)), np.full(len(shapes), int(Status.CONVERGED))
    coarse = face_points(nodes, faces, 10)
    for env, (shape, pose) in enumerate(zip(shapes, poses, strict=True)):
        s, distance = _advance(coarse.reshape(-1, 3), shape, pose, -RETREAT_MM)
        if s == -RETREAT_MM:
            status[env] = Status.STARTS_INSIDE
            continue
        if s > RETREAT_MM:
            status[env] = Status.NEVER_TOUCHES
            continue
        near = distance.reshape(len(faces), -1).min(axis=1)
        close = near < near.min() + 0.02
        fine = face_points(nodes, faces[close], 80)
        travel[env], _ = _advance(fine.reshape(-1, 3), shape, pose, max(s - 0.02, -RETREAT_MM))
    return travel, status
