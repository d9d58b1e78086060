"""Resultants, distances and room."""

import numpy as np
import pytest
import warp as wp

from simgen.simulation.first_touch import dense_shapes
from tests.fem.contact.pressed_box import CUBE, NEAR, SPHERE, K, contact, forces, pose, state


def test_a_flat_overlap_presses_with_stiffness_times_depth_times_area():
    nodes, term = contact(0.0, CUBE)
    rest = state(np.zeros(3 * len(nodes)))
    term.set_pose(pose(0.0, 0.01, 0.0))
    force, moment, rms, deepest, area, _ = term.resultants(rest).read()
    np.testing.assert_allclose(force[0], [0.0, K * 0.01 * 36.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(moment[0], 0.0, atol=1e-12)
    assert rms[0] == pytest.approx(0.01) and deepest[0] == pytest.approx(0.01) and area[0] == pytest.approx(36.0)
    nodal = forces(term, rest).reshape(-1, 3).sum(axis=0)
    np.testing.assert_allclose(nodal, -force[0], atol=1e-12)



def test_the_nearest_point_is_looked_for_between_the_integration_points():
    nodes, term = contact(0.0, SPHERE)
    rest = state(np.zeros(3 * len(nodes)))
    term.set_pose(pose(0.0, -0.1, 0.0))
    dense = wp.array(dense_shapes(12, linear=False), dtype=wp.float64, device="cpu")
    assert term.nearest(rest, dense).read()[0] == pytest.approx(0.1, abs=1e-12)  # the middle of the top is a point
    assert term.gap(rest).min() > 0.1001



@pytest.mark.parametrize("height, room", [(1.0, 0.9), (0.05, -0.05)])
def test_room_is_what_is_left_between_two_shapes(height, room):
    """Two spheres with their tips at y = 0.1 and at a height, the surface at y = 0."""
    nodes, term = contact(0.0, SPHERE)
    _, other = contact(0.0, SPHERE)
    rest, dense = state(np.zeros(3 * len(nodes))), wp.array(dense_shapes(12, linear=False), dtype=wp.float64)
    facing = pose(0.0, height, 0.0)
    facing[0, :3, :3] = np.diag([1.0, -1.0, -1.0])
    other.set_pose(facing)
    term.set_pose(pose(0.0, 0.1, 0.0))
    assert term.room(rest, dense, other).read() == pytest.approx(room, abs=1e-12)
    term.set_pose(pose(0.0, -0.01, 0.0))
    assert term.room(rest, dense, other).read() == np.inf  # nothing overlaps


def test_forces_at_corners_add_up_to_the_resultant():
    nodes, term = contact(0.78, SPHERE)
    rest = state(np.zeros(3 * len(nodes)))
    term.begin_increment(rest, rest, pose(0.0, 0.1, 0.0), pose(0.05, 0.2, 0.0), NEAR)
    sums = wp.zeros((term.n_slots, 3, 1), dtype=wp.float64, device="cpu")
    term.add_corner_forces(sums, rest)
    force, moment, *_ = term.resultants(rest).read()
    at_corners, corners = sums.numpy()[:, :, 0], nodes[term.corners]
    np.testing.assert_allclose(at_corners.sum(axis=0), force[0], rtol=1e-12)
    np.testing.assert_allclose(np.cross(corners, at_corners).sum(axis=0), moment[0], atol=1e-10)  # faces are flat
    assert abs(force[0, 0]) > 0.05 * force[0, 1]
