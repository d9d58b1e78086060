"""Distances between bodies, on bodies whose distances are known."""

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from simgen.geometry.curved_tetrahedra import CORE, FREE
from simgen.geometry.surface import ClosestPoint
from simgen.sensors.indenter import load_indenter
from simgen.verification.validate.published_geometry import tip_distances, touchable_distances, wall_thickness


def shell(outer_mm: float, inner_mm: float) -> tuple[trimesh.Trimesh, np.ndarray]:
    """Concentric spheres, m, and the regions of their faces."""
    outer, inner = (trimesh.creation.icosphere(subdivisions=3, radius=1e-3 * r) for r in (outer_mm, inner_mm))
    inner.invert()
    region = np.repeat([FREE, CORE], [len(outer.faces), len(inner.faces)])
    return trimesh.util.concatenate([outer, inner]), region


@pytest.fixture(scope="module")
def ours():
    surface, region = shell(10.0, 8.0)
    closest = ClosestPoint(surface.vertices, surface.faces)
    return SimpleNamespace(true=SimpleNamespace(surface=surface, region=region, closest=closest))


def test_a_larger_sphere_is_away_by_the_difference_of_the_radii(ours):
    to, back = touchable_distances(ours, shell(10.3, 8.0)[0])
    np.testing.assert_allclose(to, 0.3, atol=0.1)  # facets
    np.testing.assert_allclose(back, 0.3, atol=0.1)


def test_walls_are_the_differences_of_radii(ours):
    own, theirs = wall_thickness(ours, shell(10.0, 7.5)[0])
    np.testing.assert_allclose(own, 2.0, atol=0.1)
    np.testing.assert_allclose(theirs, 2.5, atol=0.1)


def test_a_tip_that_is_thicker_is_away_by_that():
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=3.6e-3)
    sphere.apply_translation([0.0, -3.5e-3, 0.0])  # about the centre of the indenter's sphere
    distances = tip_distances(load_indenter("sphere_7mm").shape(), sphere)
    assert len(distances) > 20
    np.testing.assert_allclose(distances, 0.1, atol=1e-6)
