"""Recovery of an indenter's pose from deformed meshes.

Vertices that stick to the indenter move with it. Between two steps of a press their displacements change by one vector,
the indenter's travel. Other vertices that are pushed inwards agree less with each other. So the vector that most pushed
vertices share gives the press axis and the travel, and the vertices that share it are touched. A least-squares fit then
gives the pose: touched vertices lie on the indenter, and no vertex lies inside.
"""

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

SAME = 0.05  # largest difference between displacements that move together, as a share of the travel
PUSHED = 0.8  # share of the largest inward displacement from which a vertex may be touched
TILT = 0.1  # rad, largest angle between the fitted axis and the travel
PRIOR = np.array([0.3, 0.0, 0.3, 0.01, 0.01, 0.01])  # mm per rad, mm per mm: holds what the contact leaves open
TOUCHED_MM = 0.03  # largest distance of a touched vertex
ROUNDS = 4  # rounds of fitting the pose and finding the touched vertices
SPINS_DEG = range(0, 180, 30)  # initial angles about the axis, if the indenter is no body of revolution
REVOLVED = ("sphere", "ring")


@dataclass(frozen=True)
class Recovery:
    """Recovered poses of an indenter.

    poses : (k, 4, 4) m, indenter frame -> frame of the mesh, at each step
    touched : number of vertices that it touches at the deepest step; fewer than six do not determine a pose
    misfit_um : root mean square distance of the touched vertices
    """

    poses: np.ndarray
    touched: int
    misfit_um: float


def recover(indenter: Indenter, mesh: OutputMesh, moved: np.ndarray) -> Recovery:
    """Recover the poses of an indenter in one press from displacements (k, v, 3) m, deepest last.

    A single step uses the travel from rest, which vertices touched later do not share. Some components of a pose stay
    arbitrary: the spin of a body of revolution, and the position of a flat face within its plane.
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
    """Return the distance of two poses' tips, um, and the angle between their axes, degrees.

    The tip of a sphere is its centre, because a turn about the centre does not change the contact.
    """
    radius = 1e-3 * indenter.spec.radius_mm if indenter.spec.kind == "sphere" else 0.0
    tips = [pose[:3, 3] - radius * pose[:3, 1] for pose in (found, known)]
    cosine = np.clip(found[:3, 1] @ known[:3, 1], -1.0, 1.0)
    return 1e6 * float(np.linalg.norm(tips[0] - tips[1])), float(np.degrees(np.arccos(cosine)))


def _normals(mesh: OutputMesh) -> np.ndarray:
    """Outward unit normals (v, 3) of the rest surface; zero at inner vertices."""
    surface = trimesh.Trimesh(mesh.vertices, mesh.surface_triangles, process=False)
    return np.asarray(surface.vertex_normals)


def _travel(change: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Change (3,) of displacement that most pushed vertices share, and a mask (v,) of these vertices."""
    inwards = -np.einsum("vi,vi->v", change, normals)
    pushed = np.flatnonzero(inwards >= PUSHED * inwards.max())
    near = cKDTree(change[pushed]).query_ball_point(change[pushed], SAME * np.linalg.norm(change[pushed], axis=1))
    most = max(near, key=len)
    shared = np.zeros(len(change), dtype=bool)
    shared[pushed[most]] = True
    return change[shared].mean(axis=0), shared


def _start(touched: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Pose (4, 4) mm along an axis, over the centre of points (t, 3), with its tip at the furthest of them."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.align_vectors([axis], [[0.0, 1.0, 0.0]])[0].as_matrix()
    centre = touched.mean(axis=0)
    pose[:3, 3] = centre + ((touched - centre) @ axis).max() * axis
    return pose


def _fit(shape: RigidShape, points: np.ndarray, touched: np.ndarray, start: np.ndarray):
    """Fit from one start: pose (4, 4) mm, mask of the touched vertices (v,), rms misfit over them, mm."""

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
    """Rotation (4, 4) about the press axis."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0.0, angle, 0.0]).as_matrix()
    return pose
