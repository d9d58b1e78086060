"""The view in three dimensions holds the deformed surface at every depth."""

import fake
import numpy as np

from simgen.report.solid_view import solid_view


def test_a_solid_view_holds_the_surface_at_every_depth(failing):
    figure = solid_view(failing, "digit", press=0, reached=4)
    assert [frame.name for frame in figure.frames] == ["0", "0.1", "0.2", "0.3", "0.4"]
    used = np.unique(fake.BALL.faces)
    for depth, frame in enumerate(figure.frames):
        displacement = failing.displacement("digit", 0, depth - 1) if depth else np.zeros_like(fake.VERTICES)
        mesh = frame.data[0]
        position = np.stack([mesh.x, mesh.y, mesh.z], axis=1)
        assert position.dtype == np.float32
        # A single is exact to 2^-24 of 7 mm, 0.4 nm.
        np.testing.assert_allclose(position, 1e3 * (fake.VERTICES + displacement)[used], atol=1e-6)
        np.testing.assert_allclose(mesh.intensity, 1e3 * np.linalg.norm(displacement, axis=1)[used], atol=1e-6)
    shown = figure.data[0]
    np.testing.assert_array_equal(used[np.stack([shown.i, shown.j, shown.k], axis=1)], fake.BALL.faces)
    np.testing.assert_array_equal(shown.x, figure.frames[-1].data[0].x)


def test_a_solid_view_has_one_scale_for_all_axes_and_depths(failing):
    scene = solid_view(failing, "digit", press=0, reached=4).layout.scene
    span = np.array([np.ptp(scene[f"{name}axis"].range) for name in "xyz"])
    aspect = np.array([scene.aspectratio[name] for name in "xyz"])
    np.testing.assert_allclose(aspect / span, aspect[0] / span[0], rtol=1e-6)
