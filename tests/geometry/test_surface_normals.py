"""Nearest points and normals of surfaces, against the sphere that they approximate."""

import fake
import numpy as np
import trimesh

from simgen.geometry.surface_normals import nearest_on_surface, vertex_normals


def test_nearest_on_surface_of_a_sphere():
    """Against the closed form: a facet is off its sphere by (circumradius)^2 / 2 R, at most edge^2 / 6 R."""
    rng = np.random.default_rng(0)
    outward = rng.normal(size=(50, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    height = rng.uniform(0.0, 1e-3, 50)
    points = (fake.RADIUS_M + height)[:, None] * outward
    distance, normal = nearest_on_surface(fake.VERTICES, fake.BALL.faces, points)
    sagitta = fake.BALL.edges_unique_length.max() ** 2 / (6 * fake.RADIUS_M)
    assert np.abs(distance - height).max() < sagitta
    smoothed, facet = np.degrees(np.arccos(np.clip(np.einsum("nki,ni->kn", normal, outward), -1, 1)))
    assert smoothed.max() < 0.5 * facet.max()
    # A facet's normal is that of its centre, off by up to its circumradius over R.
    assert facet.max() < np.degrees(fake.BALL.edges_unique_length.max() / np.sqrt(3) / fake.RADIUS_M)


def test_normals_of_a_cube_s_corners_point_outwards():
    """Against the sum of trimesh's face normals, weighted by area."""
    cube = trimesh.creation.box([2.0, 2.0, 2.0]).subdivide()
    corner = np.flatnonzero((np.abs(cube.vertices) == 1.0).all(axis=1))
    normals = vertex_normals(np.asarray(cube.vertices), cube.faces)[corner]
    area = np.zeros((len(corner), 3))
    for row, vertex in enumerate(corner):
        around = (cube.faces == vertex).any(axis=1)
        area[row] = (cube.face_normals[around] * cube.area_faces[around, None]).sum(axis=0)
    np.testing.assert_allclose(normals, area / np.linalg.norm(area, axis=1, keepdims=True), atol=1e-12)
    assert (np.sign(normals) == cube.vertices[corner]).all()
    assert (vertex_normals(np.zeros((1, 3)), np.zeros((0, 3), int)) == 0.0).all()
