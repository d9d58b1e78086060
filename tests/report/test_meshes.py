"""Deformed meshes of a press."""

from simgen.report.choice import furthest_press
from simgen.report.meshes import draw_press


def test_a_press_is_drawn_to_the_depth_that_it_reached(failing):
    press, reached = furthest_press(failing, indenter=1)
    assert (press, reached) == (1, 2)
    titles = [axes.get_title() for axes in draw_press(failing, press, reached).axes]
    assert titles[:4] == ["digit, 0.1 mm", "digit, 0.2 mm", "biotac, 0.1 mm", "biotac, 0.2 mm"]
