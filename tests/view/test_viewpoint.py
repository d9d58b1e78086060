"""Directions to look from."""

import numpy as np
import pytest

from simgen.view.viewpoint import contact_viewpoint, side_viewpoint, top_viewpoint

NORMALS = [np.array([0.0, -1.0, 0.0]), np.array([-1.0, 0.0, 0.0]), np.array([0.6, -0.64, 0.48])]


@pytest.mark.parametrize("normal", NORMALS)
@pytest.mark.parametrize("viewpoint", [side_viewpoint, top_viewpoint])
def test_a_viewer_is_outside_and_stands_upright(normal, viewpoint):
    found = viewpoint(normal, np.zeros(3))
    assert found.towards_viewer @ normal > 0.2
    np.testing.assert_allclose(np.linalg.norm([found.towards_viewer, found.up], axis=1), 1.0)
    assert found.towards_viewer @ found.up == pytest.approx(0.0, abs=1e-12)


def test_from_the_side_the_indenter_comes_from_above():
    for normal in NORMALS:
        assert side_viewpoint(normal, np.zeros(3)).up @ normal > 0.9
        assert top_viewpoint(normal, np.zeros(3)).towards_viewer @ normal > 0.7


def test_a_press_is_looked_at_where_it_touches(whole):
    press = 7
    found = contact_viewpoint(whole, "biotac", press)
    np.testing.assert_allclose(found.target_mm, 1e3 * whole["press/contact_pose"][press][:3, 3])
    assert found.up @ whole["press/contact_normal"][press] > 0.9
    from_above = contact_viewpoint(whole, "biotac", press, with_indenter=False)
    assert from_above.towards_viewer @ whole["press/contact_normal"][press] > 0.7


def test_without_a_contact_the_middle_of_the_sensor_is_looked_at(imported):
    found = contact_viewpoint(imported, "digit", 0)
    np.testing.assert_allclose(found.target_mm, 0.0, atol=1e-6)
    assert found.towards_viewer[1] < 0.0
