"""What a sensor's panel puts on its stage."""

import numpy as np
import pytest
from nicegui import ui

from simgen.sensors.indenter import load_indenter
from simgen.view.colours import SurfaceField
from simgen.view.drawn_indenter import DrawnIndenter
from simgen.view.drawn_surface import PressedSurface
from simgen.view.sensor_panel import GEL, INDENTER, SEEN, SensorPanel
from simgen.view.stage import GLASS, Stage
from simgen.view.viewpoint import top_viewpoint
from view.page_parts import elements, fire, html, numbers, texts

POSE = np.array([[1.0, 0.0, 0.0, 2.0], [0.0, 1.0, 0.0, 3.0], [0.0, 0.0, 1.0, 4.0], [0.0, 0.0, 0.0, 1.0]])


@pytest.fixture
def pressed(whole) -> PressedSurface:
    return PressedSurface(whole, "digit")


@pytest.fixture
def panel(client, sent) -> SensorPanel:
    panel = SensorPanel("digit <1>")
    fire(panel.stage, "ready")
    sent.clear()
    return panel


def test_the_gel_is_put_at_rest_and_moves(client, panel, pressed, sent):
    surface = pressed.surface
    panel.put_gel(surface)
    moved = pressed.positions(0, 3)
    values = np.linspace(0.0, 0.25, len(moved), dtype=np.float32)
    field = SurfaceField("displacement", "mm", values, 0.25)
    panel.move_gel(moved, field)
    (_, put, _, points, triangles, *_), (_, move, _, moved_points, colours) = sent
    assert (put, move) == ("put", "move") and {call[2] for call in sent} == {GEL}
    np.testing.assert_array_equal(numbers(points), surface.rest_mm)
    np.testing.assert_array_equal(numbers(triangles, "<u4"), surface.triangles)
    np.testing.assert_array_equal(numbers(moved_points), moved)
    np.testing.assert_array_equal(numbers(colours, "u1"), field.colours)
    assert texts(client) == ["0", "0.25 mm (displacement)"]
    assert html(client) == "<h3>digit &lt;1&gt;</h3>"


def test_a_scale_without_a_unit(client, panel, pressed):
    panel.put_gel(pressed.surface)
    rest = pressed.surface.rest_mm
    panel.move_gel(rest, SurfaceField("contact patch", "", np.zeros(len(rest), np.float32), 1.0))
    assert texts(client) == ["0", "1 (contact patch)"]


def test_the_indenter_is_glass_at_its_pose_or_not_there(panel, sent):
    drawn = DrawnIndenter.of(load_indenter("sphere_7mm"))
    panel.put_indenter(drawn, POSE, visible=False)
    (_, *put), (_, *pose), (_, *show) = sent
    assert put[:2] == ["put", INDENTER] and put[-1] == GLASS
    np.testing.assert_array_equal(numbers(put[2]), drawn.vertices_mm)
    assert pose == ["pose", INDENTER, POSE.ravel().tolist()] and show == ["show", INDENTER, False]
    for nothing in ((None, POSE), (drawn, None)):
        panel.put_indenter(drawn, POSE, visible=True)
        sent.clear()
        panel.put_indenter(*nothing, visible=True)
        assert sent == [(panel.stage, "remove", INDENTER)]


def test_the_view_holds_the_gel(panel, pressed, sent):
    """Contact and gel are in a ball of 0.9 of the diagonal around what is looked at."""
    contact = np.array([0.0, -7.0, 0.0])
    panel.look(top_viewpoint(np.array([0.0, -1.0, 0.0]), contact), pressed.surface)
    (_, look, _, _, target, radius) = sent[0]
    diagonal = np.linalg.norm(np.ptp(pressed.surface.rest_mm, axis=0))
    assert look == "look" and radius == pytest.approx(SEEN * diagonal)
    np.testing.assert_allclose(target, 0.5 * contact, atol=1e-6)


def test_a_click_on_the_gel_gives_the_place_and_one_beside_it_does_not(client):
    places = []
    panel = SensorPanel("digit", places.append)
    for body in (INDENTER, GEL):
        fire(panel.stage, "place", {"body": body, "point": [1.0, 2.0, 3.0]})
    assert [place.tolist() for place in places] == [[1.0, 2.0, 3.0]]


def test_a_caption_is_text(client, panel):
    panel.caption.text = "<b>not reached</b>"
    assert "<b>not reached</b>" in texts(client) and "<b>" not in html(client)
    assert len(elements(client, Stage)) == 1 and len(elements(client, ui.html)) == 1
