"""Signed distances of all shapes: their normal and curvature are derivatives."""

import numpy as np
import pytest
import trimesh
import warp as wp

from simgen.geometry.rigid_shape import mesh_distance, sampled_shape, shape_array, signed_distance
from simgen.geometry.signed_distance import RigidShape, distance
from simgen.sensors.indenter import indenter_names, load_indenter

NAMES = indenter_names()


def near_surface(name: str, count: int = 20000) -> tuple[np.ndarray, ...]:
    """Random points from 0.3 mm inside (less than any fillet) to 1 mm outside, with their probes."""
    shape = load_indenter(name).shape()
    low, high = load_indenter(name).extent * 1e3
    points = np.random.default_rng(0).uniform([*(low - 2.0)[:1], -4.0, low[2] - 2.0], high + 2.0, (count, 3))
    distance, normal, curvature = signed_distance(shape, points)
    kept = (distance > -0.3) & (distance < 1.0)
    return shape, points[kept], distance[kept], normal[kept], curvature[kept]


def central_difference(shape, points, step):
    """Gradient (n, 3) of the distance and derivative (n, 3, 3) of the normal."""
    offsets = step * np.eye(3)
    sides = [[signed_distance(shape, points + sign * offset) for sign in (1, -1)] for offset in offsets]
    gradient = np.stack([(a[0] - b[0]) / (2 * step) for a, b in sides], axis=-1)
    hessian = np.stack([(a[1] - b[1]) / (2 * step) for a, b in sides], axis=-1)
    return gradient, hessian


@pytest.mark.parametrize("name", NAMES)
def test_normal_is_a_unit_vector_that_curvature_leaves_unchanged(name):
    """Eikonal equation |n| = 1, and its derivative H n = 0, to round-off."""
    _, _, _, normal, curvature = near_surface(name)
    assert np.abs(np.linalg.norm(normal, axis=1) - 1.0).max() < 1e-14
    assert np.abs(np.einsum("nij,nj->ni", curvature, normal)).max() < 1e-13


@pytest.mark.parametrize("name", NAMES)
def test_normal_and_curvature_are_the_derivatives(name):
    """Central differences converge with the square of the step, away from kinks of the curvature."""
    shape, points, _, normal, curvature = near_surface(name)
    errors = {}
    for step in (1e-2, 1e-3, 1e-4):
        gradient, hessian = central_difference(shape, points, step)
        curved = np.abs(curvature).max(axis=(1, 2)) > 0.0
        errors[step] = [
            np.abs(gradient - normal).max(axis=1)[curved],
            np.abs(hessian - curvature).max(axis=(1, 2))[curved],
        ]
    for coarse, fine, finest in zip(*errors.values(), strict=True):
        assert np.median(coarse) > 1e-8  # else the next line could not fail
        assert np.median(fine) < 0.02 * np.median(coarse)
        # Few differences of 1e-4 mm straddle a seam between two parts of the shape, where curvature jumps.
        assert np.quantile(finest, 0.995) < 1e-6


def test_distance_is_the_distance_to_the_drawn_surface():
    """A drawn mesh has edges of 0.35 mm and less, which sag by 0.35^2 / 8 r = 0.015 mm over a 1 mm fillet."""
    for name in NAMES:
        indenter = load_indenter(name)
        _, points, distance, _, _ = near_surface(name, 3000)
        error = np.abs(mesh_distance(indenter.mesh(), points) - distance)
        # Inside a union the nearer part's distance is a bound, and the drawing keeps the parts' inner walls.
        measured = distance > (0.0 if name == "texture_14mm" else -0.3)
        assert error[measured].max() < 0.016, name


@pytest.fixture(scope="module")
def sampled_sphere():
    return sampled_shape(trimesh.creation.icosphere(subdivisions=5, radius=3.5e-3), 0.2, 2.0)


def test_sampled_derivatives(sampled_sphere):
    """The spline's own derivatives, inside the grid and outside it, where its boundary value is extended."""
    points = np.random.default_rng(2).uniform(-9.0, 9.0, (4000, 3))
    points = points[np.abs(np.abs(points) - 5.5).min(axis=1) > 0.3]  # the boundary of the grid is a kink
    _, normal, curvature = signed_distance(sampled_sphere, points)
    gradient, hessian = central_difference(sampled_sphere, points, 1e-4)
    assert np.abs(gradient - normal).max() < 1e-6
    # The third derivative of a cubic spline jumps from cell to cell, so a difference is first order there.
    assert np.quantile(np.abs(hessian - curvature).max(axis=(1, 2)), 0.99) < 1e-5


@wp.kernel(enable_backward=False)
def distance_kernel(shapes: wp.array(dtype=RigidShape), points: wp.array(dtype=wp.vec3d),
                    distance_out: wp.array(dtype=wp.float64)):  # fmt: skip
    i = wp.tid()
    distance_out[i] = distance(shapes[0], points[i])


@pytest.mark.parametrize("name", [*NAMES, "sampled"])
def test_the_distance_alone_is_the_probe_s(name, sampled_sphere):
    shape = sampled_sphere if name == "sampled" else load_indenter(name).shape()
    points = np.random.default_rng(4).uniform(-9.0, 9.0, (4000, 3))  # the grid of the sampled one ends at 5.5
    found = wp.zeros(len(points), dtype=wp.float64, device="cpu")
    inputs = [shape_array([shape], "cpu"), wp.array(points, dtype=wp.vec3d, device="cpu")]
    wp.launch(distance_kernel, dim=len(points), inputs=inputs, outputs=[found], device="cpu")
    np.testing.assert_allclose(found.numpy(), signed_distance(shape, points)[0], rtol=0.0, atol=1e-13)
