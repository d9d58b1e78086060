"""Distances from the touchable surface to contacts, on the stand-in dataset."""

import fake
import numpy as np
import pytest

from simgen.dataset.touchable import touchable_surface
from simgen.pipeline.run import run
from simgen.report.coverage import contacts_on, coverage


def test_the_touchable_area_is_that_of_the_ball_below_the_cap(failing):
    surface = touchable_surface(failing, "digit")
    whole = (~fake.HELD)[fake.BALL.faces].all(axis=1)
    assert surface.areas.sum() == pytest.approx(fake.BALL.area_faces[whole].sum(), rel=1e-12)
    assert set(surface.points) == set(np.flatnonzero(~fake.HELD))


def test_coverage_is_the_distance_to_the_nearest_contact(failing):
    surface, contacts = touchable_surface(failing, "digit"), contacts_on(failing, "digit")
    found = coverage(surface, contacts.points)
    expected = failing["press/contact_pose"][::3, :3, 3]
    np.testing.assert_array_equal(contacts.points, expected)
    distance = np.linalg.norm(fake.VERTICES[surface.points][:, None] - expected, axis=2).min(axis=1)
    np.testing.assert_allclose(found.distance, distance, rtol=1e-12)
    for value, share in ((found.median, 0.5), (found.percentile_95, 0.95)):
        below = surface.areas[distance < value].sum() / surface.areas.sum()
        upto = surface.areas[distance <= value * (1 + 1e-12)].sum() / surface.areas.sum()
        assert below < share <= upto
    assert (found.contacts, found.area) == (4, pytest.approx(surface.areas.sum()))


def test_contacts_are_brought_into_the_sensor_s_own_frame(tmp_path):
    """A sensor that is turned and moved in the shared frame."""
    plan = fake.make_plan(fake.make_job())
    turn = np.array([[0.0, 0.0, 1.0, 1e-3], [1.0, 0.0, 0.0, 2e-3], [0.0, 1.0, 0.0, 3e-3], [0.0, 0.0, 0.0, 1.0]])
    plan.arrays["biotac/pose"] = np.tile(turn, (12, 1, 1))
    dataset = run(plan, tmp_path / "d.zarr", build=fake.fake_presser)
    shared = np.concatenate([dataset["press/contact_pose"][::3, :3, 3], np.ones((4, 1))], axis=1)
    own = contacts_on(dataset, "biotac")
    np.testing.assert_allclose(own.points, (shared @ np.linalg.inv(turn).T)[:, :3], atol=1e-15)
    np.testing.assert_allclose(own.normals @ turn[:3, :3].T, dataset["press/contact_normal"][::3], atol=1e-15)


def test_contacts_of_which_nothing_converged_do_not_count(missing):
    assert len(contacts_on(missing, "digit").points) == 4  # their other indenters did
    statuses = missing["digit/status"]
    assert (statuses[1::3] == 2).all()
