"""The map of contacts on the stand-in: a ball, on which arcs are known."""

import fake
import numpy as np
import pytest
from matplotlib.path import Path as Polygon

from simgen.dataset.reader import Dataset
from simgen.view.contact_map import AXES, FLAT_AXES, ContactMap

PIXEL_MM = 0.25


def test_contacts_lie_at_their_arcs(whole):
    found = ContactMap.of_dataset(whole)
    assert (found.sensor, found.axes, found.trajectories.tolist()) == ("digit", AXES, [0, 1, 2, 3])
    x, y, z = whole["press/contact_pose"][::3, :3, 3].T
    arc = np.hypot(y, z) * np.arctan2(z, -y)  # along the circle at x
    np.testing.assert_allclose(found.points_mm, 1e3 * np.stack([arc, x], axis=1), atol=2 * PIXEL_MM)


def test_the_outline_is_around_the_touchable_skin(whole):
    found = ContactMap.of_dataset(whole)
    (outline,) = found.outlines
    assert (outline[0] == outline[-1]).all()
    assert Polygon(outline).contains_points(found.points_mm).all()
    radius = 1e3 * fake.RADIUS_M
    assert outline[:, 1].min() == pytest.approx(-radius, abs=1.0) and outline[:, 1].max() == pytest.approx(
        radius, abs=1.0
    )
    # Held is what lies above half the radius: at x = 0 the skin ends 120 degrees from the pole at -y.
    assert outline[:, 0].max() == pytest.approx(radius * np.radians(120.0), abs=1.0)


def test_a_skin_that_cannot_be_unrolled_is_shown_flat(whole, monkeypatch):
    above = {name: whole[name].copy() for name in ("digit/rest_positions",)}
    above["digit/rest_positions"][:, 2] += 0.1  # nothing is around the plane z = 0
    read = Dataset.__getitem__
    monkeypatch.setattr(Dataset, "__getitem__", lambda self, name: above[name] if name in above else read(self, name))
    found = ContactMap.of_dataset(whole)
    assert found.axes == FLAT_AXES and found.outlines == ()
    np.testing.assert_allclose(found.points_mm, 1e3 * whole["press/contact_pose"][::3][:, [2, 0], 3])


def test_an_unfinished_dataset_knows_all_its_contacts(unfinished):
    assert np.isfinite(ContactMap.of_dataset(unfinished).points_mm).all()


def test_imported_files_say_where_first_touch_is(whole, imported):
    """Their indenters stand at first touch, which is 10 um from the contact."""
    found, known = ContactMap.of_dataset(imported), ContactMap.of_dataset(whole)
    assert found.axes == AXES and len(found.outlines) == 1
    np.testing.assert_allclose(found.points_mm, known.points_mm, atol=2 * PIXEL_MM)
