"""The presses that a page shows."""

import numpy as np

from simgen.report.choice import depths_reached, drawn_presses, furthest_press


def test_presses_are_drawn_evenly_and_always_the_same(failing, missing):
    chosen = drawn_presses(failing, "digit", 6)
    assert np.bincount(failing["press/indenter"][chosen]).tolist() == [2, 2, 2]
    np.testing.assert_array_equal(chosen, drawn_presses(failing, "digit", 6))
    assert drawn_presses(failing, "digit", 1000).tolist() == list(range(12))
    assert set(missing["press/indenter"][drawn_presses(missing, "digit", 1000)]) == {0, 2}


def test_what_is_reached(failing, missing):
    assert depths_reached(failing, "digit").tolist() == [4, 2, 4] * 4
    assert furthest_press(failing) == (0, 4)
    assert furthest_press(missing, indenter=1)[1] == 0
