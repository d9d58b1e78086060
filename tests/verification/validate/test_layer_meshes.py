"""The round layer's meshes: graded, round, and the same each time."""

import math

import numpy as np
import pytest

from simgen.fem.elements.element import P2P1, face_geometry, tet_geometry
from simgen.geometry.curved_tetrahedra import determinants
from simgen.geometry.interpolation import interpolation_matrix
from simgen.verification.validate.layer_meshes import graded, make_sensor, rings, round_layer
from simgen.verification.validate.meshes import faces_on, on_plane, top


def coarse_mesh(quarters=1):
    return round_layer(graded(10.0, 0.8, 1.0, 0.5), graded(4.0, 0.8, 0.8, 0.25), 3, quarters)


def test_graded_points_grow_steadily_from_the_fine_edge_to_the_end():
    r = graded(10.0, 0.25, 0.7, 0.1)
    spacing = np.diff(r)
    assert (r[0], r[-1]) == (0.0, pytest.approx(10.0, abs=1e-12))
    assert spacing[0] == pytest.approx(0.25, rel=0.05)
    assert (np.diff(spacing) > -1e-6).all()
    assert (spacing[1:] / spacing[:-1]).max() < 1.2
    # A spacing that grows by s per mm makes steps of ratio exp(s), but for the whole number of steps.
    np.testing.assert_allclose((spacing[1:] / spacing[:-1])[-4:], math.exp(0.1), rtol=5e-3)


@pytest.mark.parametrize("quarters", [1, 2])
def test_rings_cover_the_sector_once(quarters):
    points, triangles = rings(np.array([0.0, 1.0, 2.0, 3.5]), 3, quarters)
    a, b, c = (points[triangles[:, i]] for i in range(3))
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    assert (area < 0.0).all()  # seen from +y, from where z turns clockwise to x, all are counter-clockwise
    boundary = 0.5 * 3.5**2 * 3 * quarters * math.sin(math.pi / 6)  # triangles of the outer polygon
    assert -area.sum() == pytest.approx(boundary, rel=1e-12)
    on_ring = np.isclose(np.linalg.norm(points, axis=1), 3.5)
    assert on_ring.sum() == 3 * quarters + 1


@pytest.mark.parametrize("quarters", [1, 2])
def test_round_layer_is_round_and_smooth(quarters):
    mesh = coarse_mesh(quarters)
    volume = tet_geometry(P2P1, mesh.nodes, mesh.tetrahedra).volumes.sum()
    assert volume == pytest.approx(100.0 * math.pi * quarters, rel=1e-3)  # quadratic edges against arcs of 30 degrees
    assert face_geometry(P2P1, mesh.nodes, top(mesh.nodes, mesh.faces)).areas.sum() == pytest.approx(
        25.0 * math.pi * quarters, rel=1e-3
    )
    radius = np.hypot(mesh.nodes[:, 0], mesh.nodes[:, 2])
    side = faces_on(mesh.faces, np.isclose(radius, 10.0))
    assert face_geometry(P2P1, mesh.nodes, side).areas.sum() == pytest.approx(20.0 * math.pi * quarters, rel=1e-3)
    assert determinants(mesh.nodes, mesh.tetrahedra).min() > 0.8  # near 1: hardly distorted by their curved edges
    planes = 2 if quarters == 1 else 1
    faces = sum(len(faces_on(mesh.faces, on_plane(mesh.nodes, axis, 0.0))) for axis in (0, 2)[-planes:])
    levels = len(np.unique(mesh.nodes[: mesh.n_corners, 1])) - 1
    assert faces == 2 * 2 * levels * (len(graded(10.0, 0.8, 1.0, 0.5)) - 1)


def test_two_makings_are_the_same_mesh():
    np.testing.assert_array_equal(coarse_mesh().nodes, coarse_mesh().nodes)


def test_output_points_take_the_quadratic_field_of_the_mesh():
    mesh = coarse_mesh()
    points = np.array([[0.3, 0.0, 0.4], [2.0, 0.0, 0.0], [0.0, 0.0, 6.0]])
    sensor = make_sensor(mesh, np.zeros(len(mesh.nodes), dtype=bool), top(mesh.nodes, mesh.faces), points)
    body = sensor.simulation_mesh
    linear = interpolation_matrix(body, sensor.output_mesh.vertices) @ body.nodes
    np.testing.assert_allclose(linear, points * 1e-3, atol=1e-12)
