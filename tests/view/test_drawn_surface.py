"""Surfaces of the stand-in: a ball, moved by a formula."""

import fake
import numpy as np
import pytest

from simgen.errors import InputError
from simgen.geometry.surface import enclosed_volume
from simgen.view.drawn_surface import AT_REST, DrawnSurface, PressedSurface

# A tetrahedron on its side, with a vertex within that no triangle has.
POSITIONS = np.array([[0, 0, 0], [9, 9, 9], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) * 1e-3
TRIANGLES = np.array([[0, 3, 2], [0, 2, 4], [0, 4, 3], [2, 3, 4]])


@pytest.fixture(scope="module")
def pressed(failing) -> PressedSurface:
    return PressedSurface(failing, "digit")


def test_a_surface_has_its_own_vertices_alone_and_faces_outwards():
    surface = DrawnSurface.of_mesh(POSITIONS, TRIANGLES)
    assert set(surface.vertices) == {0, 2, 3, 4} and surface.triangles.dtype == np.int32
    np.testing.assert_allclose(surface.rest_mm, 1e3 * POSITIONS[surface.vertices], rtol=1e-6)
    np.testing.assert_array_equal(surface.vertices[surface.triangles], TRIANGLES)
    assert enclosed_volume(surface.rest_mm, surface.triangles) == pytest.approx(1 / 6)


def test_a_crease_parts_the_surface_and_a_smooth_edge_does_not():
    """All edges of a tetrahedron are creases, so each of its four sides has three vertices. A ball has none."""
    parted = DrawnSurface.of_mesh(POSITIONS, TRIANGLES)
    assert len(parted.vertices) == 4 * 3
    np.testing.assert_array_equal(np.array([0, 2, 3, 4])[parted.in_outputs], parted.vertices)
    ball = DrawnSurface.of_mesh(fake.VERTICES, fake.BALL.faces)
    assert ball.vertices.tolist() == np.unique(fake.BALL.faces).tolist()


def test_a_displaced_vertex_is_at_rest_plus_its_displacement():
    surface = DrawnSurface.of_mesh(POSITIONS, TRIANGLES)
    move = 1e-4 * np.arange(15.0).reshape(5, 3)
    np.testing.assert_allclose(surface.displaced(move), 1e3 * (POSITIONS + move)[surface.vertices], atol=1e-6)
    np.testing.assert_array_equal(surface.displaced(np.full((5, 3), np.nan)), surface.rest_mm)


def test_positions_of_a_press_are_those_of_the_formula(failing, pressed):
    press, step = 3, 2
    expected = fake.fake_result(0, failing["press/contact_pose"][press], failing["depth"], 0.0).displacement[step]
    found = pressed.positions(press, step)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, 1e3 * (fake.VERTICES + expected), atol=1e-4)  # stored in steps of 0.1 um
    assert enclosed_volume(found, pressed.surface.triangles) > 0.0


def test_a_step_that_was_not_reached_shows_the_gel_at_rest(pressed):
    assert [pressed.is_reached(1, step) for step in (AT_REST, 0, 1, 2, 3)] == [True, True, True, False, False]
    np.testing.assert_array_equal(pressed.positions(1, 3), pressed.surface.rest_mm)
    np.testing.assert_array_equal(pressed.positions(1, AT_REST), pressed.surface.rest_mm)
    assert not np.array_equal(pressed.positions(1, 1), pressed.surface.rest_mm)


def test_presses_that_are_not_there_yet_are_at_rest(unfinished):
    pressed = PressedSurface(unfinished, "biotac")
    assert pressed.is_reached(0, 3) and not pressed.is_reached(11, 0)
    np.testing.assert_array_equal(pressed.positions(11, 0), pressed.surface.rest_mm)


def test_a_press_is_read_once(pressed, monkeypatch):
    before = pressed.positions(5, 0)
    monkeypatch.setattr(pressed.dataset, "displacement", None)
    assert not np.array_equal(pressed.positions(5, 3), before)


def test_a_file_that_is_gone_is_named(unfinished):
    (unfinished.path / "digit/displacement/c/0/0/0/0").unlink()
    with pytest.raises(InputError, match="digit/displacement/c/0/0/0/0: is gone"):
        PressedSurface(unfinished, "digit").positions(0, 0)
