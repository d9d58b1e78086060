"""The developed skin, on surfaces whose sections are known."""

import numpy as np
import pytest
import trimesh

from simgen.geometry.developed_skin import Skin, corner_normals

RADIUS, LENGTH = 7.0e-3, 30.0e-3


@pytest.fixture(scope="module")
def cylinder():
    """A closed cylinder along x, 256 facets around and two rings of vertices."""
    mesh = trimesh.creation.cylinder(radius=RADIUS, height=LENGTH, sections=256)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0.0, 1.0, 0.0]))
    return mesh


def test_arc_length_on_a_cylinder(cylinder):
    """An arc s leads to the angle s / r, within the sag of the chords: r (pi / 256)^2 / 2 = 0.5 um."""
    skin = Skin(cylinder)
    for x in (-0.011, 0.0, 0.004):
        for arc in np.linspace(-0.02, 0.02, 9):
            point, normal = skin.point(x, arc)
            angle = arc / RADIUS
            exact = np.array([0.0, -np.cos(angle), np.sin(angle)])
            np.testing.assert_allclose(point, RADIUS * exact + [x, 0.0, 0.0], atol=4e-6)
            np.testing.assert_allclose(normal, exact, atol=1e-3)


def test_there_is_nothing_beyond_the_skin(cylinder):
    skin = Skin(cylinder)
    assert skin.point(LENGTH, 0.0) is None
    assert skin.point(0.0, 1.01 * np.pi * RADIUS) is None
    assert skin.point(0.0, 0.99 * np.pi * RADIUS) is not None


def test_a_section_through_vertices(cylinder):
    """A plane that holds a whole ring of vertices still cuts one closed loop."""
    both = cylinder.subdivide()  # halves every edge, so a ring of vertices lies in x = 0
    assert (both.vertices[:, 0] == 0.0).sum() > 256
    point, _ = Skin(both).point(0.0, 0.005)
    angle = 0.005 / RADIUS
    np.testing.assert_allclose(point, [0.0, -RADIUS * np.cos(angle), RADIUS * np.sin(angle)], atol=4e-6)


def test_the_outer_wall_of_a_shell():
    """The pad's centre line runs on the outermost wall."""
    inner = trimesh.creation.box(extents=[0.020, 0.004, 0.008])
    inner.invert()
    shell = trimesh.util.concatenate([trimesh.creation.box(extents=[0.024, 0.008, 0.012]), inner])
    point, normal = Skin(shell).point(0.001, 0.007)
    np.testing.assert_allclose(point, [0.001, -0.003, 0.006], atol=1e-12)
    np.testing.assert_allclose(normal, [0.0, 0.0, 1.0], atol=1e-12)


def test_normals_stop_at_a_crease():
    box = trimesh.creation.box(extents=[1.0, 1.0, 1.0])
    np.testing.assert_allclose(corner_normals(box), np.repeat(box.face_normals[:, None], 3, axis=1), atol=1e-12)


def test_normals_of_a_sphere():
    """Averaged normals are the sphere's, within the square of the edge angle (0.08)."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    np.testing.assert_allclose(corner_normals(ball), ball.vertices[ball.faces], atol=5e-3)


def test_many_arcs_of_a_section_are_the_same_as_one_by_one():
    """On a shape whose cross-sections all differ, inside and beyond its ends."""
    mesh = trimesh.creation.icosphere(subdivisions=3)
    mesh.apply_transform(np.diag([0.020, 0.008, 0.011, 1.0]))
    skin, arcs = Skin(mesh), np.linspace(-0.04, 0.04, 33)
    for x in (-0.021, -0.0199, 0.0, 0.0071, 0.021):
        for many, arc in zip(skin.points(x, arcs), arcs, strict=True):
            one = skin.point(x, arc)
            assert (many is None) == (one is None)
            assert one is None or np.array_equal(many, one)
    assert all(each is None for each in skin.points(0.021, arcs))
    assert 0 < sum(each is None for each in skin.points(0.0, arcs)) < len(arcs)
