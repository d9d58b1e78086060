"""Forces of a contact and their tangent."""

import numpy as np
import pytest
import warp as wp

from simgen.fem import blocks
from tests.fem.contact.pressed_box import NEAR, SPHERE, contact, forces, pose, state, update

SINGLE = 5e-6  # relative: rounding of 6e-8 for each of some hundred operations


@pytest.mark.parametrize(("friction", "sideways"), [(0.0, 0.0), (0.78, 1e-4), (0.78, 0.05)])
def test_tangent_against_finite_differences(friction, sideways):
    """Without friction, sticking (small slip) and sliding (large slip)."""
    nodes, term = contact(friction, SPHERE)
    n = 3 * len(nodes)
    rng = np.random.default_rng(0)
    start = 1e-3 * rng.normal(size=n)
    term.begin_increment(state(start), state(start), pose(0.3, 0.2, 0.1), pose(0.3 + sideways, 0.2, 0.1), NEAR)
    update(term, state(start))
    x, v = start + 1e-5 * rng.normal(size=n), rng.normal(size=n)
    term.linearize(state(x))
    out = wp.zeros((n, 1), dtype=wp.float32, device="cpu")
    term.tangent(wp.array(v[:, None], dtype=wp.float32, device="cpu"), out)
    h = 1e-8
    difference = (forces(term, state(x + h * v)) - forces(term, state(x - h * v))) / (2 * h)
    error = np.linalg.norm(difference - out.numpy()[:, 0]) / np.linalg.norm(difference)
    # The friction tangent leaves out how the tangent plane turns: |tau| / R against k, below 1 %.
    assert error < (1e-6 if friction == 0.0 else 1e-2)


def test_diagonal_blocks_are_those_of_the_tangent():
    nodes, term = contact(0.5, SPHERE)
    term.set_pose(pose(0.0, 0.2, 0.0))
    term.linearize(state(np.zeros(nodes.size)))
    made = blocks.zeros(len(nodes), 1, "cpu")
    term.diagonal(made)
    diagonal = blocks.of_environment(made, 0)
    touched = np.flatnonzero(np.abs(diagonal).max(axis=(1, 2)) > 0.0)
    assert len(touched) > 5
    for node in touched[::5]:
        for i in range(3):
            out = wp.zeros((nodes.size, 1), dtype=wp.float32, device="cpu")
            unit = np.eye(nodes.size)[:, 3 * node + i : 3 * node + i + 1]
            term.tangent(wp.array(unit, dtype=wp.float32, device="cpu"), out)
            column = out.numpy().reshape(-1, 3)[node]
            np.testing.assert_allclose(diagonal[node, :, i], column, rtol=0, atol=SINGLE * np.abs(column).max())
