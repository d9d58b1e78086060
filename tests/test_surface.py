"""Closest points and smooth patches, against brute force and shapes whose answer is known."""

import numpy as np
import pytest
import trimesh

from simgen.surface import ClosestPoint, enclosed_volume, shells, smooth_patches


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
