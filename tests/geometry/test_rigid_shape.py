"""Shapes made on the host: sampled from a mesh, several in one kernel, and their reach."""

import numpy as np
import pytest
import trimesh

from simgen.geometry.rigid_shape import lateral_reach, sampled_shape, signed_distance
from simgen.sensors.indenter import indenter_names, load_indenter

NAMES = indenter_names()


@pytest.fixture(scope="module")
def sampled_sphere():
    return sampled_shape(trimesh.creation.icosphere(subdivisions=5, radius=3.5e-3), 0.2, 2.0)


def test_sampled_sphere_matches_the_exact_one(sampled_sphere):
    """The facets (edges of 0.14 mm) sag by 0.0009 mm; the spline follows them, which roughens curvature."""
    rng = np.random.default_rng(1)
    direction = rng.normal(size=(4000, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    radius = 3.5 + rng.uniform(-0.5, 1.5, 4000)
    distance, normal, curvature = signed_distance(sampled_sphere, radius[:, None] * direction)
    assert np.abs(distance - (radius - 3.5)).max() < 0.002
    assert np.abs(normal - direction).max() < 0.02
    exact = (np.eye(3) - direction[:, :, None] * direction[:, None, :]) / radius[:, None, None]
    assert np.sqrt(((curvature - exact) ** 2).mean()) < 0.03


def test_far_points_are_outside(sampled_sphere):
    directions = np.random.default_rng(3).normal(size=(1000, 3))
    points = 100.0 * directions / np.linalg.norm(directions, axis=1)[:, None]
    distance = signed_distance(sampled_sphere, points)[0]
    # Clamping to the box overestimates by no more than the box's half diagonal.
    assert (np.abs(distance - 96.5) < 5.7 * np.sqrt(3.0)).all()


def test_mixed_shapes_in_one_kernel(sampled_sphere):
    """One shape per environment: each point gets its own shape, coefficients included."""
    other = sampled_shape(trimesh.creation.box(extents=[4e-3, 4e-3, 4e-3]), 0.25, 1.0)
    shapes = [*(load_indenter(name).shape() for name in NAMES), sampled_sphere, other]
    points = np.random.default_rng(4).uniform(-4.0, 4.0, (50 * len(shapes), 3))
    together = signed_distance(shapes, points)
    for index, shape in enumerate(shapes):
        alone = signed_distance(shape, points[index :: len(shapes)])
        for a, b in zip(together, alone, strict=True):
            np.testing.assert_array_equal(a[index :: len(shapes)], b)


@pytest.mark.parametrize("name", NAMES)
def test_no_shape_reaches_further_than_it_says(name):
    """The shape is nowhere beyond its reach, and somewhere at 0.9 of it."""
    shape = load_indenter(name).shape()
    reach, angles = lateral_reach(shape), np.linspace(0.0, 2.0 * np.pi, 73)
    ring = np.stack([np.cos(angles), np.zeros_like(angles), np.sin(angles)], axis=1)
    heights = np.linspace(-9.0, 0.0, 19)[:, None, None] * [0.0, 1.0, 0.0]
    beyond, within = ((heights + share * reach * ring).reshape(-1, 3) for share in (1.001, 0.9))
    assert signed_distance(shape, beyond)[0].min() > 0.0
    assert signed_distance(shape, within)[0].min() < 0.0
