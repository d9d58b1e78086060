"""Forces along a path with a leg after the press."""

import fake
import numpy as np
import pytest

from simgen.pipeline.run import run
from simgen.report.path import along_path, path_section


@pytest.fixture(scope="module")
def sheared(tmp_path_factory):
    path = [{"move_mm": [0.2, 0.0, 0.0], "steps": 3}]
    job = fake.make_job(indenters=["sphere_7mm"], trajectories={"count": 1, "path": path})
    return run(fake.make_plan(job), tmp_path_factory.mktemp("path") / "d.zarr", build=fake.fake_presser)


def test_a_press_alone_has_no_section(failing):
    assert not list(path_section(failing))


def test_quantities_are_the_stand_in_s(sheared):
    """The stand-in has 1 N per mm along the axis, 10 and 20 N/m across it, and half of the contact sliding."""
    normal, shear, sliding = along_path(sheared, "digit")
    depths = sheared.indenter_path.depths_m
    np.testing.assert_allclose(normal, np.tile(1e3 * depths, (1, 1)), rtol=1e-12)
    np.testing.assert_allclose(shear, np.tile(np.hypot(10.0, 20.0) * depths, (1, 1)), rtol=1e-12)
    assert (sliding == 0.5).all()


def test_the_section_says_where_legs_end(sheared):
    first, tiles = path_section(sheared)
    assert "Leg 0 ends at step 4" in first and "Leg 1 ends at step 7" in first
    assert tiles.count("<img ") == 1
