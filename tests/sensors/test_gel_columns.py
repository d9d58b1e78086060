"""Columns of gel: exact on boxes, on the bundled sensors against distances to their surfaces."""

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from simgen.geometry.curved_tetrahedra import CORE, FREE, HELD
from simgen.geometry.rigid_shape import mesh_distance
from simgen.sensors.gel_columns import GelColumns, Lattice
from simgen.sensors.pairing import indenter_poses, sample_contacts
from simgen.sensors.sensor import load_sensor


def box(size, at=(0.0, 0.0, 0.0)) -> trimesh.Trimesh:
    """A box in m of which size and place are in mm."""
    made = trimesh.creation.box(extents=np.array(size) * 1e-3)
    return made.apply_translation(np.array(at) * 1e-3)


def bonded(surface: trimesh.Trimesh, back_mm: float) -> SimpleNamespace:
    """A gel whose faces at y = back are held."""
    held = np.isclose(surface.triangles[:, :, 1].min(axis=1), back_mm * 1e-3)
    return SimpleNamespace(surface=surface, surface_region=np.where(held, HELD, FREE), core=None)


def above(x: float, y: float, z: float) -> np.ndarray:
    """(1, 4, 4) the pose of an indenter with its tip there, mm, that presses along +y."""
    pose = np.eye(4)
    pose[:3, 3] = np.array([x, y, z]) * 1e-3
    return pose[None]


def test_a_lattice_is_centred_on_the_axis():
    points = Lattice(0.5, 2, 1).points
    assert points.shape == (15, 2)
    np.testing.assert_array_equal(points[[0, 7, 14]], [[-1.0, -0.5], [0.0, 0.0], [1.0, 0.5]])


def test_columns_of_a_slab_have_its_thickness_within_its_outline():
    columns = GelColumns(bonded(box([4.0, 3.0, 2.0]), 1.5))(above(0.3, -1.0, 0.0), Lattice(0.25, 12, 8))
    x, z = Lattice(0.25, 12, 8).points.T
    inside = (np.abs(x + 0.3) < 2.0) & (np.abs(z) <= 1.0)
    np.testing.assert_allclose(columns.surface[0, inside], -0.5, atol=1e-9)
    np.testing.assert_allclose(columns.rigid[0, inside], 2.5, atol=1e-9)
    np.testing.assert_allclose(columns.thickness[0, inside], 3.0, atol=1e-9)
    assert np.isinf(columns.surface[0, ~inside]).all() and np.isinf(columns.rigid[0, ~inside]).all()


def test_a_column_that_leaves_by_a_side_wall_has_nothing_rigid_behind_it():
    """Tilted by 45 degrees over a slab of 4 x 3 mm: columns reach the back where they enter 3 mm before its end."""
    pose = above(0.0, -1.5, 0.0)
    pose[0, :3, :3] = trimesh.transformations.rotation_matrix(np.pi / 4, [0.0, 0.0, 1.0])[:3, :3]
    lattice = Lattice(0.1, 13, 0)
    columns = GelColumns(bonded(box([4.0, 3.0, 2.0]), 1.5))(pose, lattice)
    entry_x = lattice.points[:, 0] * np.sqrt(2.0)  # on the upper face; columns lean towards -x
    on_back = entry_x - 3.0 > -2.0
    np.testing.assert_array_equal(np.isfinite(columns.rigid[0]), on_back)
    np.testing.assert_allclose(columns.thickness[0, on_back], 3.0 * np.sqrt(2.0), atol=1e-9)
    assert np.isfinite(columns.surface[0]).all()


def test_behind_a_skin_is_the_core_and_nothing_beside_it():
    cavity = box([8.0, 6.0, 8.0])
    cavity.invert()
    surface = trimesh.util.concatenate([box([10.0, 8.0, 10.0]), cavity])
    region = np.repeat([FREE, CORE], 12)
    sensor = SimpleNamespace(surface=surface, surface_region=region, core=box([4.0, 5.0, 4.0]))
    lattice = Lattice(0.5, 9, 9)
    columns = GelColumns(sensor)(above(0.0, -4.0, 0.0), lattice)
    over_core = (np.abs(lattice.points) <= 2.0).all(axis=1)
    np.testing.assert_allclose(columns.rigid[0, over_core], 1.5, atol=1e-9)  # skin of 1 mm, gap of 0.5 mm
    np.testing.assert_allclose(columns.thickness[0, over_core], 1.0, atol=1e-9)
    assert np.isinf(columns.rigid[0, ~over_core]).all()


@pytest.mark.parametrize("name", ["digit", "biotac", "gelsight_mini"])
def test_columns_begin_and_end_on_the_surfaces_of_a_sensor(name):
    sensor = load_sensor(name)
    contacts = sample_contacts(sensor, 3, 1, 1e-3)
    poses, lattice = indenter_poses(contacts), Lattice(0.5, 10, 10)
    columns = GelColumns(sensor)(poses, lattice)
    for n, pose in enumerate(poses):
        there = np.isfinite(columns.rigid[n])
        x, z = lattice.points[there].T

        def points_at(heights, pose=pose, x=x, z=z):
            return 1e3 * pose[:3, 3] + np.column_stack([x, heights, z]) @ pose[:3, :3].T

        assert there.sum() > 100
        entry, rigid = columns.surface[n, there], columns.rigid[n, there]
        inner = entry + columns.thickness[n, there]
        bodies = [sensor.surface] if sensor.core is None else [sensor.surface, sensor.core]
        for heights, surfaces in ((entry, bodies[:1]), (inner, bodies[:1]), (rigid, bodies)):
            off = [np.abs(mesh_distance(surface, points_at(heights))) for surface in surfaces]
            assert np.min(off, axis=0).max() < 1e-4  # mm, single precision
        assert mesh_distance(sensor.surface, points_at(0.5 * (entry + inner))).max() < 0.0  # within the gel
