"""The developed skin, on surfaces whose sections are known."""

import numpy as np
import pytest
import trimesh

from simgen.geometry.developed_skin import Skin, corner_normals, skin_of

RADIUS, LENGTH = 7.0e-3, 30.0e-3


@pytest.fixture(scope="module")
def cylinder():
    """A closed cylinder along x, 256 facets around and two rings of vertices."""
    mesh = trimesh.creation.cylinder(radius=RADIUS, height=LENGTH, sections=256)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0.0, 1.0, 0.0]))
    return mesh


def test_arc_length_on_a_cylinder(cylinder):
    """An arc s leads to the angle s / r, within the sag of the chords: r (pi / 256)^2 / 2 = 0.5 um."""
    x, arc = np.meshgrid([-0.011, 0.0, 0.004], np.linspace(-0.02, 0.02, 9), indexing="ij")
    points, normals = Skin(cylinder).points(x, arc)
    assert points.shape == normals.shape == (3, 9, 3)
    exact = np.stack([np.zeros(x.shape), -np.cos(arc / RADIUS), np.sin(arc / RADIUS)], axis=-1)
    on_axis = np.stack([x, np.zeros(x.shape), np.zeros(x.shape)], axis=-1)
    np.testing.assert_allclose(points, on_axis + RADIUS * exact, atol=4e-6)
    np.testing.assert_allclose(normals, exact, atol=1e-3)


def test_there_is_nothing_beyond_the_skin(cylinder):
    half_way = np.pi * RADIUS
    for found in Skin(cylinder).points([LENGTH, 0.0, 0.0, 0.0], [0.0, 1.01 * half_way, 0.99 * half_way, 50 * half_way]):
        np.testing.assert_array_equal(np.isnan(found), np.repeat([[True], [True], [False], [True]], 3, axis=1))


def test_no_places_are_on_no_skin(cylinder):
    assert all(found.shape == (0, 3) for found in Skin(cylinder).points(np.empty(0), np.empty(0)))


def test_a_surface_that_was_changed_has_another_skin():
    ball = trimesh.creation.icosphere()
    first = skin_of(ball)
    assert skin_of(ball) is first
    ball.apply_scale(2.0)
    np.testing.assert_array_equal(skin_of(ball).points(0.1, 0.2)[0], 2.0 * first.points(0.05, 0.1)[0])


def test_a_section_through_vertices(cylinder):
    """A plane that holds a whole ring of vertices still cuts one closed loop."""
    both = cylinder.subdivide()  # halves every edge, so a ring of vertices lies in x = 0
    assert (both.vertices[:, 0] == 0.0).sum() > 256
    point, _ = Skin(both).points(0.0, 0.005)
    angle = 0.005 / RADIUS
    np.testing.assert_allclose(point, [0.0, -RADIUS * np.cos(angle), RADIUS * np.sin(angle)], atol=4e-6)


def test_the_outer_wall_of_a_shell():
    """The pad's centre line runs on the outermost wall."""
    inner = trimesh.creation.box(extents=[0.020, 0.004, 0.008])
    inner.invert()
    shell = trimesh.util.concatenate([trimesh.creation.box(extents=[0.024, 0.008, 0.012]), inner])
    point, normal = Skin(shell).points(0.001, 0.007)
    np.testing.assert_allclose(point, [0.001, -0.003, 0.006], atol=1e-12)
    np.testing.assert_allclose(normal, [0.0, 0.0, 1.0], atol=1e-12)


def test_normals_stop_at_a_crease():
    box = trimesh.creation.box(extents=[1.0, 1.0, 1.0])
    np.testing.assert_allclose(corner_normals(box), np.repeat(box.face_normals[:, None], 3, axis=1), atol=1e-12)


def test_normals_of_a_sphere():
    """Averaged normals are the sphere's, within the square of the edge angle (0.08)."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    np.testing.assert_allclose(corner_normals(ball), ball.vertices[ball.faces], atol=5e-3)


@pytest.fixture(scope="module")
def ellipsoid():
    """A shape whose cross-sections all differ."""
    mesh = trimesh.creation.icosphere(subdivisions=3)
    mesh.apply_transform(np.diag([0.020, 0.008, 0.011, 1.0]))
    return mesh


def test_many_places_at_once_are_the_same_as_one_by_one(ellipsoid):
    """Inside and beyond the ends of the shape, through its vertices, and at once over a grid."""
    skin, arcs = Skin(ellipsoid), np.linspace(-0.04, 0.04, 33)
    x = np.array([-0.021, -0.0199, 0.0, ellipsoid.vertices[100, 0], 0.0071, 0.021])
    many = skin.points(x[:, None], arcs)
    one_by_one = [skin.points(a, b) for a in x for b in arcs]
    for values, single in zip(many, zip(*one_by_one, strict=True), strict=True):
        np.testing.assert_array_equal(values.reshape(-1, 3), single)
    missing = np.isnan(many[0][..., 0]).sum(axis=1)
    assert missing[0] == missing[-1] == len(arcs) and (missing[1:-1] < len(arcs)).all() and missing[2] > 0


def test_places_are_those_of_a_polygon_that_trimesh_cuts(ellipsoid):
    """The arc length along the polygon from the centre line to the point is the arc that was asked for."""
    skin, arcs = Skin(ellipsoid), np.linspace(-0.012, 0.012, 7)
    for x in (-0.0123, 0.0044, 0.0101):
        [polygon] = ellipsoid.section(plane_origin=[x, 0.0, 0.0], plane_normal=[1.0, 0.0, 0.0]).discrete
        points, _ = skin.points(x, arcs)
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(polygon, axis=0), axis=1))])
        at = [_length_at(polygon, length, point) for point in [*points, skin.points(x, 0.0)[0]]]
        along = np.array(at[:-1]) - at[-1]
        along -= length[-1] * np.round(along / length[-1])  # the polygon may begin anywhere
        direction = np.sign(along[-1])
        np.testing.assert_allclose(direction * along, arcs, atol=1e-7)  # trimesh merges points within 1e-8


def _length_at(polygon: np.ndarray, length: np.ndarray, point: np.ndarray) -> float:
    """Length along a polygon (p, 3) to a point (3,) on it, for the lengths (p,) to its corners."""
    along = np.diff(polygon, axis=0)
    t = np.clip(np.einsum("ij,ij->i", point - polygon[:-1], along) / np.einsum("ij,ij->i", along, along), 0.0, 1.0)
    away = np.linalg.norm(polygon[:-1] + t[:, None] * along - point, axis=1)
    nearest = away.argmin()
    assert away[nearest] < 1e-7
    return length[nearest] + t[nearest] * np.linalg.norm(along[nearest])
