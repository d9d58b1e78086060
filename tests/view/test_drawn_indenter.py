"""The drawn indenter, against the shape that presses."""

import numpy as np
import pytest
import trimesh

from simgen.dataset.contact_patch import FACET_M
from simgen.geometry.surface import ClosestPoint
from simgen.sensors.indenter import indenter_names, load_indenter, signed_distance
from simgen.view.drawn_indenter import DrawnIndenter, PressingIndenters
from simgen.view.drawn_surface import AT_REST, PressedSurface
from simgen.view.surface_fields import CONTACT, SurfaceFields


@pytest.mark.parametrize("name", indenter_names())
def test_vertices_near_the_tip_lie_on_the_shape(name):
    indenter = load_indenter(name)
    drawn = DrawnIndenter.of(indenter)
    assert (drawn.name, drawn.vertices_mm.dtype, drawn.triangles.dtype) == (name, np.float32, np.int32)
    front = drawn.vertices_mm[drawn.vertices_mm[:, 1] > -1.0]
    distance, *_ = signed_distance(indenter.shape(), front.astype(float))
    assert distance.max() < 1e-3  # bumps of a texture have parts within it
    assert drawn.vertices_mm[:, 1].max() == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize("step", [0, 3])
def test_points_that_touch_lie_near_the_drawn_mesh(whole, step):
    """Each point of the contact patch is in the drawn indenter or within the patch's margin of it."""
    press, pressed, indenters = 3, PressedSurface(whole, "biotac"), PressingIndenters(whole)
    touching = SurfaceFields(pressed).field(CONTACT, press, step).values == 1.0
    pose, drawn = indenters.pose("biotac", press, step), indenters.drawn(press)
    mesh = trimesh.Trimesh(drawn.vertices_mm @ pose[:3, :3].T + pose[:3, 3], drawn.triangles, process=False)
    points = pressed.positions(press, step)[touching].astype(float)
    nearest, distance, face = ClosestPoint(mesh.vertices, mesh.faces)(points)
    outside = np.einsum("ni,ni->n", points - nearest, mesh.face_normals[face]) > 0.0
    assert touching.any() and distance[outside].max(initial=0.0) < 1e3 * FACET_M + 0.01  # the drawn sphere has facets


def test_the_tip_goes_down_by_the_depth_from_first_touch(whole):
    indenters, press = PressingIndenters(whole), 4
    start = indenters.pose("digit", press, AT_REST)
    for step, depth in enumerate(whole["depth"]):
        pose = indenters.pose("digit", press, step)
        np.testing.assert_allclose(pose[:3, 3] - start[:3, 3], 1e3 * depth * start[:3, 1], atol=1e-9)
        np.testing.assert_allclose(pose[:3, :3], start[:3, :3])
    contact = whole["press/contact_pose"][press]  # both sensors of the stand-in lie in the shared frame
    np.testing.assert_allclose(start[:3, 3], 1e3 * (contact[:3, 3] + 2e-5 * contact[:3, 1]), atol=1e-9)


def test_on_a_leg_it_moves_sideways_and_turns(sliding):
    indenters = PressingIndenters(sliding)
    pressed, slid = indenters.pose("digit", 0, 3), indenters.pose("digit", 0, 5)
    np.testing.assert_allclose(slid[:3, 3] - pressed[:3, 3], 0.5 * pressed[:3, 0], atol=1e-9)
    np.testing.assert_allclose(slid[:3, 1], pressed[:3, 1])
    assert slid[:3, 0] @ pressed[:3, 0] == pytest.approx(np.cos(np.radians(20.0)))


def test_without_first_touch_there_is_no_pose(unfinished):
    assert PressingIndenters(unfinished).pose("digit", 11, 0) is None
    assert PressingIndenters(unfinished).pose("digit", 0, 0) is not None


def test_imported_files_say_where_the_indenter_is(whole, imported):
    found, known = PressingIndenters(imported), PressingIndenters(whole)
    assert found.drawn(0).name == "sphere_7mm"
    for sensor in whole.sensors:
        np.testing.assert_allclose(found.pose(sensor, 0, 2), known.pose(sensor, 0, 2), atol=1e-5)


def test_an_indenter_that_has_changed_is_not_drawn_and_a_sentence_says_why(whole, monkeypatch):
    monkeypatch.setitem(whole.attributes["indenters"]["ring_7mm"], "fillet_mm", 9.0)
    indenters = PressingIndenters(whole)
    assert indenters.drawn(1) is None and indenters.drawn(0).name == "sphere_7mm"
    assert indenters.why_not(0) == "" and "ring_7mm: not the indenter that was pressed" in indenters.why_not(1)
