"""Closest points and smooth patches, against brute force and shapes whose answer is known."""

import numpy as np
import pytest
import trimesh

from simgen.geometry.surface import ClosestPoint, FinePieces, enclosed_volume, shells, smooth_patches


@pytest.mark.parametrize("unit", [1.0, 1e-3])  # in metres, trimesh's tolerances would matter
def test_closest_points_are_the_best_of_all_triangles(unit):
    body = trimesh.creation.box([20.0, 4.0, 20.0])  # twelve large triangles: centroids far from most points
    body.apply_scale(unit)
    points = np.random.default_rng(1).uniform(-15.0, 15.0, (300, 3)) * unit
    on, distance, face = ClosestPoint(body.vertices, body.faces)(points)
    # The distance to a box is known: its half sizes clamp the point, or the nearest wall does from inside.
    half = np.array([10.0, 2.0, 10.0]) * unit
    outside = np.linalg.norm(np.maximum(np.abs(points) - half, 0.0), axis=1)
    inside = (half - np.abs(points)).min(axis=1)
    np.testing.assert_allclose(distance, np.where(outside > 0, outside, inside), atol=1e-9 * unit)
    np.testing.assert_allclose(np.linalg.norm(points - on, axis=1), distance, atol=1e-12 * unit)
    offset = np.einsum("ij,ij->i", on - body.vertices[body.faces[face, 0]], body.face_normals[face])
    np.testing.assert_allclose(offset, 0.0, atol=1e-9 * unit)


def test_pieces_in_balls_are_those_of_the_whole_surface_subdivided():
    body = trimesh.creation.icosphere(2, radius=5.0)
    fine = body.subdivide_to_size(0.3)
    centres = np.random.default_rng(1).normal(0.0, 3.0, (20, 3))
    radii = np.linspace(1.0, 2.0, 20)
    pieces, ball, owner = FinePieces(body.triangles).near(centres, radii, np.full(20, 0.3))
    for i, (centre, radius) in enumerate(zip(centres, radii, strict=True)):
        found = np.unique(np.round(pieces[ball == i].reshape(-1, 3), 9), axis=0)
        inside = np.linalg.norm(found - centre, axis=1) <= radius
        expected = fine.vertices[np.linalg.norm(fine.vertices - centre, axis=1) <= radius]
        np.testing.assert_allclose(found[inside], np.unique(np.round(expected, 9), axis=0).reshape(-1, 3), atol=1e-8)
    normals = np.cross(pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0])
    assert (np.einsum("ni,ni->n", normals, body.face_normals[owner]) > 0.0).all()


def test_pieces_of_selected_triangles_are_as_long_as_each_ball_allows():
    """Two balls of one centre: the first wants the upper triangles in pieces of 0.3, the other the rest as they are."""
    body = trimesh.creation.icosphere(1, radius=5.0)
    upper = body.triangles_center[:, 2] > 0.0
    pieces, ball, owner = FinePieces(body.triangles).near(
        np.zeros((2, 3)), np.full(2, 6.0), np.array([0.3, 10.0]), lambda ball, triangle: upper[triangle] == (ball == 0)
    )
    assert upper[owner[ball == 0]].all()
    np.testing.assert_array_equal(np.sort(owner[ball == 1]), np.flatnonzero(~upper))
    edges = np.linalg.norm(pieces - np.roll(pieces, 1, axis=1), axis=2).max(axis=1)
    assert edges[ball == 0].max() <= 0.3 < edges[ball == 1].min()
    area = np.bincount(owner, np.linalg.norm(np.cross(*(pieces[:, i] - pieces[:, 0] for i in (1, 2))), axis=1) / 2)
    np.testing.assert_allclose(area, body.area_faces)


def test_without_balls_there_are_no_pieces():
    none = FinePieces(trimesh.creation.box().triangles).near(np.empty((0, 3)), np.empty(0), np.empty(0))
    assert [each.shape for each in none] == [(0, 3, 3), (0,), (0,)]


def test_a_ball_holds_few_pieces_however_small_it_is():
    """Right triangles with hypotenuses of r / 4 or more, r / 64 square each, within 1.5 r of the centre."""
    surface = FinePieces(trimesh.creation.box([20.0, 4.0, 20.0]).triangles)
    radii = np.array([1.0, 1e-2, 1e-4])
    _, ball, _ = surface.near(np.tile([0.1, 2.0, 0.2], (3, 1)), radii, 0.5 * radii)
    assert 0 < np.bincount(ball, minlength=3).max() < np.pi * 1.5**2 * 64


def test_a_box_has_six_patches_and_a_ball_one():
    assert smooth_patches(trimesh.creation.box()).max() + 1 == 6
    assert smooth_patches(trimesh.creation.icosphere(3)).max() + 1 == 1


def test_shells_and_signed_volumes():
    outer, cavity = trimesh.creation.icosphere(2, radius=2.0), trimesh.creation.icosphere(2)
    cavity.invert()
    both = trimesh.util.concatenate([outer, cavity])
    volumes = sorted(enclosed_volume(both.vertices, both.faces[faces]) for faces in shells(both))
    np.testing.assert_allclose(volumes, [cavity.volume, outer.volume])
    assert volumes[0] < 0
