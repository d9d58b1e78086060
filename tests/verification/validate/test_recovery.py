"""Recovery of an indenter's pose from displacements made for a known pose."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from simgen.geometry.tetrahedra import OutputMesh
from simgen.sensors.indenter import load_indenter, signed_distance
from simgen.verification.validate.recovery import pose_difference, recover

SPACING_MM = 0.5


@pytest.fixture(scope="module")
def plate():
    """A bumpy bowl of 20 mm, touchable from -y. No face of an indenter fits it."""
    x, z = np.meshgrid(*2 * [np.arange(-10.0, 10.1, SPACING_MM)], indexing="ij")
    y = 0.01 * (x**2 + z**2) + 0.1 * np.sin(x) * np.cos(1.3 * z)
    vertices = 1e-3 * np.stack([x, y, z], axis=-1).reshape(-1, 3)
    n = len(x)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate([
        np.stack([corner, corner + n, corner + 1], axis=1), np.stack([corner + n, corner + n + 1, corner + 1], axis=1)
    ])  # fmt: skip
    if trimesh.Trimesh(vertices, faces, process=False).face_normals[:, 1].mean() > 0:
        faces = faces[:, ::-1]
    everything = np.ones(len(vertices), dtype=bool)
    return OutputMesh(vertices, np.zeros((0, 4), np.int32), faces, ~everything, everything, "")


def pushed(mesh: OutputMesh, indenter, pose: np.ndarray) -> np.ndarray:
    """Displacements (v, 3) m: each vertex that the indenter reaches moves along its axis until it lies on it."""
    local = (1e3 * mesh.vertices - 1e3 * pose[:3, 3]) @ pose[:3, :3]
    low, high = np.zeros(len(local)), np.full(len(local), 5.0)
    reached = signed_distance(indenter.shape(), local)[0] < 0.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        inside = signed_distance(indenter.shape(), local + middle[:, None] * [0.0, 1.0, 0.0])[0] < 0.0
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    return 1e-3 * np.where(reached, high, 0.0)[:, None] * pose[:3, 1]


def tilted_pose(tip_mm: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("yxz", [25.0, 4.0, -3.0], degrees=True).as_matrix()
    pose[:3, 3] = 1e-3 * tip_mm
    return pose


@pytest.mark.parametrize("name", ["sphere_7mm", "cylinder_short_7mm", "ring_7mm", "texture_14mm"])
@pytest.mark.parametrize("steps", [1, 3])
def test_the_pose_comes_back(plate, name, steps):
    indenter = load_indenter(name)
    last = tilted_pose(np.array([0.4, 1.5, -0.3]))
    poses = np.repeat(last[None], steps, axis=0)
    poses[:, :3, 3] -= 3e-4 * np.arange(steps)[::-1, None] * last[:3, 1]
    moved = np.stack([pushed(plate, indenter, pose) for pose in poses])
    found = recover(indenter, plate, moved)
    tip_um, axis_deg = pose_difference(found.poses[-1], last, indenter)
    print(f"{name}: {tip_um:.2f} um, {axis_deg:.3f} deg, {found.touched} vertices, {found.misfit_um:.2f} um")
    # A vertex up to 30 um away counts as touched; over the 3 mm of a contact that is half a degree.
    assert tip_um < 30.0
    assert axis_deg < 0.5
    travel = np.linalg.norm(found.poses[:-1, :3, 3] - found.poses[-1, :3, 3], axis=1)
    np.testing.assert_allclose(travel, 3e-4 * np.arange(steps)[:0:-1], rtol=0.01)


def test_few_vertices_are_said_to_be_few(plate):
    """A sphere that just reaches the plate moves too few vertices to determine a pose."""
    indenter = load_indenter("sphere_3.5mm")
    pose = np.eye(4)
    pose[1, 3] = 1e-5  # m, past the vertex in the middle of the plate
    moved = pushed(plate, indenter, pose)
    assert 0 < np.count_nonzero(moved.any(axis=1)) < 6
    assert recover(indenter, plate, moved[None]).touched < 6
