"""Candidates of an increment."""

import numpy as np

from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from tests.fem.contact.pressed_box import NEAR, contact, pose, state


def test_only_faces_that_can_touch_are_candidates():
    """A small sphere over a corner: near faces, at once or after a longer way, and those whose multipliers press."""
    nodes, term = contact(0.0, rigid_shape(Kind.SPHERE, 0.5))
    rest = state(np.zeros(3 * len(nodes)))
    assert term.surface.count.numpy()[0] == len(term.host_faces)  # before an increment begins
    counts = []
    for travel in (0.0, 2.0, 10.0):
        here = pose(2.5, -0.1, 2.5)
        term.begin_increment(rest, rest, here, here, np.array([travel]))
        counts.append(int(term.surface.count.numpy()[0]))
        chosen = term.surface.candidates.numpy()[: counts[-1], 0]
        gap = term.gap(rest)[:, :, 0].min(axis=1)
        assert set(chosen) == set(np.flatnonzero(gap < travel + 2.0))  # faces have edges of 2 mm
    assert 0 < counts[0] < counts[1] < counts[2] == len(term.host_faces)
    term.surface.normal.fill_(1.0)
    term.begin_increment(rest, rest, pose(0.0, -50.0, 0.0), pose(0.0, -50.0, 0.0), NEAR)
    assert term.surface.count.numpy()[0] == len(term.host_faces)
