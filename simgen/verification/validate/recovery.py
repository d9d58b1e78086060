"""Where was the indenter? Its pose from a deformed mesh alone.

Vertices that an indenter carries along move as it does: between two steps of a press the displacements of those that
stick to it change by the very same vector, the indenter's travel, and of the vertices that are pushed inwards no others
agree as well. That tells the press axis, the travel, and which vertices are touched. The pose then follows by least
squares: the touched vertices lie on the indenter, and no vertex of the surface lies in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.optimize import least_squares
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from simgen.geometry.rigid_shape import signed_distance
from simgen.geometry.signed_distance import RigidShape
from simgen.geometry.tetrahedra import OutputMesh
from simgen.sensors.indenter import Indenter

SAME = 0.05  # of the travel: displacements that differ by less moved together
PUSHED = 0.8  # of the largest displacement inwards: what is pushed less is not touched
TILT = 0.1  # rad: how far the fit may turn the axis away from the travel
PRIOR = np.array([0.3, 0.0, 0.3, 0.01, 0.01, 0.01])  # mm per rad, mm per mm: what the fit does not tell stays
TOUCHED_MM = 0.03  # nearer than this a vertex is touched
ROUNDS = 4  # of fitting the pose and finding the touched vertices
SPINS_DEG = range(0, 180, 30)  # tried about the axis, but for bodies of revolution
REVOLVED = ("sphere", "ring")


@dataclass(frozen=True)
class Recovery:
    """What the mesh tells of an indenter.

    poses : (k, 4, 4) m, indenter frame -> frame of the mesh, at each step
    touched : vertices that it touches at the deepest step; six numbers make a pose, so fewer do not tell it
    misfit_um : how far the touched vertices are from it, root mean square
    """

    poses: np.ndarray
    touched: int
    misfit_um: float


def recover(indenter: Indenter, mesh: OutputMesh, moved: np.ndarray) -> Recovery:
    """The indenter at the steps of one press, from displacements (k, v, 3) m, deepest last.

    With a single step the travel from rest stands in, which vertices reached later share less well. What the contact
    does not tell means nothing: the spin of a body of revolution, the place of a flat face along itself.
    """
    shape = indenter.shape()
    normals = _normals(mesh)[mesh.touchable]
    displacement = 1e3 * moved[:, mesh.touchable]
    points = 1e3 * mesh.vertices[mesh.touchable] + displacement[-1]
    earlier = displacement[:-1] if len(displacement) > 1 else np.zeros_like(displacement)
    found = [_travel(displacement[-1] - before, normals) for before in earlier]
    axis = sum(travel for travel, _ in found)
    touched = found[-1][1]
    start = _start(points[touched], axis / np.linalg.norm(axis))
    spins = [0] if indenter.spec.kind in REVOLVED else SPINS_DEG
    fits = [_fit(shape, points, touched, start @ _spun(np.radians(spin))) for spin in spins]
    pose, touched, _ = min(fits, key=lambda fit: fit[2])
    behind = [np.linalg.norm(travel) for travel, _ in found] if len(displacement) > 1 else []
    poses = np.repeat(pose[None], len(displacement), axis=0)
    poses[:, :3, 3] -= np.array([*behind, 0.0])[:, None] * pose[:3, 1]
    poses[:, :3, 3] *= 1e-3
    misfit = _distances(shape, points[touched], pose)
    return Recovery(poses, int(touched.sum()), float(1e3 * np.sqrt((misfit**2).mean())))


def pose_difference(found: np.ndarray, known: np.ndarray, indenter: Indenter) -> tuple[float, float]:
    """How far two poses are apart: the tip in um, the press axis in degrees.

    For the tip of a hemisphere its centre is taken: turned about it, the sphere touches the same.
    """
    radius = 1e-3 * indenter.spec.radius_mm if indenter.spec.kind == "sphere" else 0.0
    tips = [pose[:3, 3] - radius * pose[:3, 1] for pose in (found, known)]
    cosine = np.clip(found[:3, 1] @ known[:3, 1], -1.0, 1.0)
    return 1e6 * float(np.linalg.norm(tips[0] - tips[1])), float(np.degrees(np.arccos(cosine)))


def _normals(mesh: OutputMesh) -> np.ndarray:
    """Outward unit normals (v, 3) of the rest surface, zero inside."""
    surface = trimesh.Trimesh(mesh.vertices, mesh.surface_triangles, process=False)
    return np.asarray(surface.vertex_normals)


def _travel(change: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The change (3,) of displacement that most of the pushed vertices share, and which ones (v,) do."""
    inwards = -np.einsum("vi,vi->v", change, normals)
    pushed = np.flatnonzero(inwards >= PUSHED * inwards.max())
    near = cKDTree(change[pushed]).query_ball_point(change[pushed], SAME * np.linalg.norm(change[pushed], axis=1))
    most = max(near, key=len)
    shared = np.zeros(len(change), dtype=bool)
    shared[pushed[most]] = True
    return change[shared].mean(axis=0), shared


def _start(touched: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Pose (4, 4) mm along an axis whose tip plane touches the points (t, 3) at the furthest, over their centre."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.align_vectors([axis], [[0.0, 1.0, 0.0]])[0].as_matrix()
    centre = touched.mean(axis=0)
    pose[:3, 3] = centre + ((touched - centre) @ axis).max() * axis
    return pose


def _fit(shape: RigidShape, points: np.ndarray, touched: np.ndarray, start: np.ndarray):
    """Pose (4, 4) mm, the touched vertices (v,), and the misfit (rms over the touched, mm) from one start."""

    def pose_of(x: np.ndarray) -> np.ndarray:
        pose = np.array(start)
        pose[:3, :3] = start[:3, :3] @ Rotation.from_euler("yxz", x[[1, 0, 2]]).as_matrix()
        pose[:3, 3] = start[:3, 3] + x[3:]
        return pose

    def residual(x: np.ndarray) -> np.ndarray:
        distance = _distances(shape, points, pose_of(x))
        return np.concatenate([np.where(touched, distance, np.minimum(distance, 0.0)), PRIOR * x])

    x, most = np.zeros(6), np.array([TILT, np.pi, TILT, np.inf, np.inf, np.inf])
    for _ in range(ROUNDS):
        found = least_squares(residual, x, bounds=(-most, most), x_scale=[0.1, 0.1, 0.1, 1.0, 1.0, 1.0])
        x = found.x
        distance = _distances(shape, points, pose_of(x))
        now = np.abs(distance) < TOUCHED_MM
        if not now.any() or (now == touched).all():
            break
        touched = now
    return pose_of(x), touched, np.sqrt(2.0 * found.cost / touched.sum())


def _distances(shape: RigidShape, points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    return signed_distance(shape, (points - pose[:3, 3]) @ pose[:3, :3])[0]


def _spun(angle: float) -> np.ndarray:
    """A turn about the press axis."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0.0, angle, 0.0]).as_matrix()
    return pose
