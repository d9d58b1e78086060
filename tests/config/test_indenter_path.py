"""Paths of indenters: where they go, leg after leg."""

import numpy as np
import pytest

from simgen.config.indenter_path import moved, press_path, turn_about_press_axis, with_legs
from simgen.config.job import load_job


def test_a_press_is_a_path_along_the_press_axis():
    path = press_path(np.array([1e-4, 3e-4]))
    np.testing.assert_array_equal(path.offsets_m, [[0.0, 1e-4, 0.0], [0.0, 3e-4, 0.0]])
    assert path.is_a_press and path.lateral_reach_m == 0.0
    assert not path.turns_rad.any()


def test_each_leg_begins_where_the_one_before_it_ended():
    path = with_legs(press_path(np.array([1e-3])), [((4e-4, 0.0, -2e-4), 0.0, 2), ((0.0, -1e-3, 0.0), 0.3, 3)])
    np.testing.assert_allclose(
        1e3 * path.offsets_m,
        [[0, 1, 0], [0.2, 1, -0.1], [0.4, 1, -0.2], [0.4, 2 / 3, -0.2], [0.4, 1 / 3, -0.2], [0.4, 0, -0.2]],
        atol=1e-6,  # whole nanometres
    )
    np.testing.assert_allclose(path.turns_rad, [0.0, 0.0, 0.0, 0.1, 0.2, 0.3])
    assert path.legs.tolist() == [0, 1, 1, 2, 2, 2]
    assert not path.is_a_press
    assert path.lateral_reach_m == pytest.approx(np.hypot(4e-4, 2e-4))


def test_only_the_way_below_the_surface_needs_room():
    """Lifted off 0.5 mm aside, on the line to a point 3 mm aside and as high as the press was deep: 1.75 mm."""
    path = with_legs(press_path(np.array([1e-3])), [((5e-4, 0.0, 0.0), 0.0, 1), ((2.5e-3, -2e-3, 0.0), 0.0, 2),
                                                    ((9e-3, 0.0, 0.0), 0.0, 1)])  # fmt: skip
    assert path.lateral_reach_m == pytest.approx(1.75e-3)
    back = with_legs(path, [((0.0, 1.5e-3, 0.0), 0.0, 1)])  # down again at 12 mm
    assert back.lateral_reach_m == pytest.approx(12e-3)


def test_poses_move_along_their_own_axes_and_turn_right_handed():
    pose = np.eye(4)
    pose[:3, :3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]  # its x is the frame's y
    pose[:3, 3] = [1.0, 2.0, 3.0]
    found = moved(pose, np.array([0.5, 0.0, 0.0]), np.pi / 2)
    np.testing.assert_allclose(found[:3, 3], [1.0, 2.5, 3.0])
    np.testing.assert_allclose(found[:3, 2], pose[:3, 0], atol=1e-15)  # right-handed about +y: z comes to x
    np.testing.assert_allclose(found[:3, 1], pose[:3, 1], atol=1e-15)
    np.testing.assert_allclose(turn_about_press_axis(np.pi / 2) @ [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], atol=1e-15)


def test_the_path_of_a_job():
    """Legs are in mm and degrees; depths are whole nanometres."""
    legs = "trajectories.path=[{move_mm: [0.5, 0, 0], steps: 2}, {turn_deg: -30, move_mm: [0, -1.5, 0], steps: 1}]"
    job = load_job("smoke", [legs])
    path = job.indenter_path
    assert len(path) == 13 and job.samples == 13 * job.presses
    np.testing.assert_array_equal(path.offsets_m[[9, 11, 12]], [[0, 1e-3, 0], [5e-4, 1e-3, 0], [5e-4, -5e-4, 0]])
    np.testing.assert_allclose(np.degrees(path.turns_rad[-2:]), [0.0, -30.0])
    np.testing.assert_array_equal(job.depths_m, path.offsets_m[:, 1])


def test_a_job_without_legs_is_the_job_it_was():
    """Its hash has neither legs nor the rule for thin gel."""
    job = load_job("smoke", ["trajectories.least_thickness_left=0"])
    assert "path" not in job.resolved()["trajectories"]
    assert job.hash == "8f67ed3dcb848538ac77a110050182f22f67fa5a40616504e337780daf7e2f43"
