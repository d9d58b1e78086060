"""The touchable surface: its points, and areas that add up to its triangles."""

import fake
import numpy as np
import pytest

from simgen.dataset.touchable import touchable_points, touchable_surface

ARRAYS = {
    "digit/rest_positions": np.vstack([fake.VERTICES, np.zeros(3)]),  # the last vertex lies inside
    "digit/surface_triangles": np.asarray(fake.BALL.faces),
    "digit/touchable": np.append(~fake.HELD, True),
}


def test_points_lie_on_the_surface_and_are_touchable():
    np.testing.assert_array_equal(touchable_points(ARRAYS, "digit"), np.flatnonzero(~fake.HELD))


def test_areas_add_up_to_the_triangles_whose_corners_are_all_touchable():
    surface = touchable_surface(ARRAYS, "digit")
    inside = (~fake.HELD)[fake.BALL.faces].all(axis=1)
    assert surface.areas.sum() == pytest.approx(fake.BALL.area_faces[inside].sum())
    away = fake.VERTICES[surface.points, 1] < 0.0  # far from the edge, points of the icosphere have similar areas
    np.testing.assert_allclose(surface.areas[away], 4 * np.pi * fake.RADIUS_M**2 / len(fake.VERTICES), rtol=0.25)


def test_values_are_spread_to_vertices():
    surface = touchable_surface(ARRAYS, "digit")
    spread = surface.on_vertices(surface.areas)
    np.testing.assert_array_equal(spread[surface.points], surface.areas)
    assert np.isnan(np.delete(spread, surface.points)).all() and len(spread) == len(fake.VERTICES) + 1
