"""Quantities that colour a live press: values at the drawn vertices, and the ends of their scales."""

import numpy as np
import pytest

from simgen.config.indenter_path import DOWN, press_path, with_legs
from simgen.view.drawn_surface import DrawnSurface
from simgen.view.live_fields import DISPLACEMENT, TRACTION, field_at_rest, live_field
from simgen.view.live_press import LivePress

# A tetrahedron on its side, with a vertex within that no triangle has; its creases part all its sides.
POSITIONS = np.array([[0, 0, 0], [9, 9, 9], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) * 1e-3
SURFACE = DrawnSurface.of_mesh(POSITIONS, np.array([[0, 3, 2], [0, 2, 4], [0, 4, 3], [2, 3, 4]]))
LENGTHS_M = np.array([1e-4, 9.0, 2e-4, 3e-4, 4e-4])  # of the vertices' displacements
KPA = np.array([0.0, np.nan, 20.0, 30.0])  # of the surface's vertices, without the one within


@pytest.fixture
def press() -> LivePress:
    """The first step has the displacements and tractions above, the second twice as large ones."""
    press = LivePress(1, with_legs(press_path(np.array([1e-4, 5e-4])), [(-7e-4 * DOWN, 0.0, 1)]))
    for step in (0, 1):
        moved, traction = np.zeros((5, 3)), np.zeros((4, 3))
        moved[:, step], traction[:, 2 - step] = (1 + step) * LENGTHS_M, 1e3 * (1 + step) * KPA
        press.outputs[step] = {"displacement": moved, "traction": traction}
    return press


def test_displacement_ends_its_scale_at_the_largest_depth_of_the_path(press):
    for step in (0, 1):
        field = live_field(DISPLACEMENT, press, SURFACE, step)
        np.testing.assert_allclose(field.values, 1e3 * (1 + step) * LENGTHS_M[SURFACE.vertices], rtol=1e-6)
        assert (field.title, field.unit, field.largest) == ("displacement", "mm", 0.5)


def test_traction_ends_its_scale_at_the_largest_so_far(press):
    own = KPA[np.searchsorted([0, 2, 3, 4], SURFACE.vertices)]
    for step in (0, 1):
        field = live_field(TRACTION, press, SURFACE, step)
        np.testing.assert_allclose(field.values, (1 + step) * own, rtol=1e-6)
        assert (field.title, field.unit, field.largest) == ("traction", "kPa", 60.0)
    del press.outputs[1]
    assert live_field(TRACTION, press, SURFACE, 0).largest == 30.0


def test_without_tractions_the_displacement_is_shown(press):
    del press.outputs[0]["traction"]
    assert live_field(TRACTION, press, SURFACE, 0).title == "displacement"


def test_at_rest_nothing_has_moved():
    field = field_at_rest(SURFACE, 8e-4)
    assert field.values.tolist() == [0.0] * 12 and (field.unit, field.largest) == ("mm", 0.8)
