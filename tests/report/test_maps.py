"""Maps of values on the touchable surface, seen from both sides."""

import fake
import numpy as np

from simgen.dataset.touchable import touchable_surface
from simgen.report.maps import draw_map


def test_each_contact_is_drawn_in_at_least_one_of_the_two_views(failing):
    surface = touchable_surface(failing, "digit")
    normals = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, -1.0, 0.0]])
    contacts = fake.RADIUS_M * normals, normals, np.zeros((3, 3))
    figure = draw_map(surface, None, "digit", contacts=contacts)
    points = [axes.collections[1].get_offsets() for axes in figure.axes]
    assert [len(each) for each in points] == [2, 2]  # a side each, and the pole, which both views show


def test_values_get_one_colour_bar_that_ends_at_the_largest(failing):
    surface = touchable_surface(failing, "digit")
    figure = draw_map(surface, np.full(len(surface.points), 2.0), "digit", "mm", largest=4.0)
    views, bar = figure.axes[:2], figure.axes[2]
    assert bar.get_ylabel() == "mm" and bar.get_ylim() == (0.0, 4.0)
    colours = views[0].collections[0].cmap([np.nan, 0.5])[:, :3]  # grey where nothing can touch, and half of 4 mm
    for axes in views:
        hues = hue(axes.collections[0].get_facecolor()[:, :3])
        assert all((np.abs(hues - own).max(axis=1) < 1e-6).any() for own in hue(colours))


def hue(colours: np.ndarray) -> np.ndarray:
    """Colours (n, 3) without their brightness, which shading changes."""
    return colours / np.linalg.norm(colours, axis=1, keepdims=True)
