"""Contacts that the plan refused, and the area that they cost."""

import fake
import numpy as np

from simgen.dataset.touchable import touchable_surface
from simgen.pipeline.run import run
from simgen.report.refused import ContactPlaces, areas, refused_lines


def test_refused_contacts_are_counted_and_shown(tmp_path):
    plan = fake.make_plan(fake.make_job())
    normals = np.array([[0.0, -1.0, 0.0], [np.sqrt(0.75), -0.5, 0.0]])
    plan.arrays |= {"refused/points": fake.RADIUS_M * normals, "refused/normals": normals}
    dataset = run(plan, tmp_path / "d.zarr", build=fake.fake_presser)
    page = "".join(refused_lines(dataset, touchable_surface(dataset, "digit")))
    assert "2 of 6 places (33.3%) were refused" in page and "less than 0.15 of the gel's thickness" in page
    assert page.count("<img alt='refused contacts on digit'") == 1


def test_the_area_without_contacts_is_that_around_the_refused_ones():
    """Skin of a ball within a distance r of a lone contact is a cap of area pi r^2."""
    plan = fake.make_plan(fake.make_job())
    surface = touchable_surface(plan.arrays, "digit")
    side = np.array([[0.0, -0.6, 0.8], [0.0, -0.6, -0.8]])
    near = 3e-3
    found = areas(surface, ContactPlaces((7e-3 * side[:1], side[:1]), (7e-3 * side, side)), near)
    cap = np.pi * near**2
    np.testing.assert_allclose(found, [2.0 * cap, cap], rtol=0.1)  # vertices are 1 mm apart
