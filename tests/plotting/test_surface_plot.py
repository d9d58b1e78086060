"""Views, shading and points of drawn surfaces."""

import fake
import numpy as np
import pytest
from matplotlib.figure import Figure

from simgen.plotting.surface_plot import camera, draw_points, draw_surface


def test_the_camera_is_a_rotation_that_looks_where_it_is_told():
    out = np.array([-1.0, -2.0, 3.0])
    free, upright = camera(out), camera(out, up=np.array([0.0, -1.0, 0.0]))
    for view in (free, upright):
        np.testing.assert_allclose(view @ view.T, np.eye(3), atol=1e-15)
        assert np.linalg.det(view) == pytest.approx(1.0)
        np.testing.assert_allclose(view[2], out / np.linalg.norm(out), atol=1e-15)
    assert free[0, 0] > 0
    assert upright[0, 1] == pytest.approx(0.0, abs=1e-15) and upright[1, 1] < 0


def test_a_ball_shows_its_near_half_and_its_colours():
    """Half of the faces look at the viewer, and each has the colour of its own vertices."""
    values = (fake.VERTICES[:, 1] < 0).astype(float)
    axes = Figure().subplots()
    faces = draw_surface(axes, fake.VERTICES, fake.BALL.faces, values, largest=1.0)
    drawn = len(faces.get_paths())
    assert abs(drawn / len(fake.BALL.faces) - 0.5) < 0.02
    assert len(np.unique(faces.get_facecolor().round(2), axis=0)) > 2


def test_points_behind_the_surface_are_not_drawn():
    axes = Figure().subplots()
    ends = np.array([[0.0, 0.0, 7e-3], [0.0, 0.0, -7e-3]])
    draw_points(axes, ends, ends, np.zeros((2, 3)), view=camera(np.array([0.3, 0.0, 1.0])))
    assert len(axes.collections[0].get_offsets()) == 1
