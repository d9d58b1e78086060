"""Marches: samples one by one, in order, and a result with the bytes of `press`."""

import numpy as np
import pytest

from simgen.errors import InputError
from simgen.fem.nonlinear.status import Status
from simgen.simulation.march import March
from simgen.simulation.press import Scene, follow, press
from simulation.blocks import DEPTHS, GEL, SPHERE, pose
from simulation.failing_steps import fail_beyond

PATH = DEPTHS[:, None] * [0.0, 1.0, 0.0]


def assert_same(result, other):
    assert result.outputs.keys() == other.outputs.keys() and result.touch == other.touch
    for name, values in result.outputs.items():
        assert values.dtype == other.outputs[name].dtype
        np.testing.assert_array_equal(values, other.outputs[name], err_msg=name)


def newest(samples):
    return {sample.step: sample.outputs for sample in samples}


def test_samples_arrive_in_order_and_the_result_has_the_bytes_of_a_press(scene, central):
    march = March(scene, SPHERE, pose()[0], PATH)
    arrived, counts = [], []
    while march.under_way:
        samples = march.advance()
        counts.append(len(samples))
        arrived += [(each.step, {name: np.array(value) for name, value in each.outputs.items()}) for each in samples]
    assert [step for step, _ in arrived] == [0, 1]
    assert max(counts) == 1 and counts[-1] == 1 and counts.count(0) > 2  # each sample came when it had converged
    assert_same(march.result, central)
    for step, outputs in arrived:
        assert outputs.keys() == central.outputs.keys()
        for name, value in outputs.items():
            np.testing.assert_array_equal(value, central.outputs[name][step], err_msg=name)


def test_touch_pose(scene):
    march = March(scene, SPHERE, pose(tilt_deg=5.0)[0], PATH)
    list(march)
    expected = pose(tilt_deg=5.0)[0]
    expected[:3, 3] += march.result.touch * expected[:3, 1]
    np.testing.assert_allclose(march.touch_pose, expected, rtol=0.0, atol=1e-12)


def test_a_march_that_was_left_changes_nothing(scene, central):
    march = March(scene, SPHERE, pose(x=1.0)[0], PATH)
    march.advance()
    after = March(scene, SPHERE, pose()[0], PATH)
    list(after)
    assert_same(after.result, central)


def test_a_path_with_shear_turn_and_a_limit(block):
    path = 1e-3 * np.array([[0.0, 0.2, 0.0], [0.1, 0.2, 0.0], [0.1, 0.3, 0.0]])
    turns = np.radians([0.0, 5.0, 5.0])
    scene = Scene(block, GEL, outputs=("traction", "error_energy"))
    march = March(scene, SPHERE, pose()[0], path, turns, steps=2)
    assert [sample.step for sample in march] == [0, 1]
    [expected] = follow(scene, [SPHERE], pose(), path, turns, np.array([2]))
    assert expected.status.tolist() == [Status.CONVERGED, Status.CONVERGED, Status.NO_ROOM]
    assert_same(march.result, expected)


@pytest.mark.parametrize(
    ("furthest_mm", "steps"),
    [((0.3, 1.0), [0, 0, 1]), ((0.3, 0.1), [0, 0]), ((0.3, 0.3), [0, 0])],
    ids=["the second try gets further", "the first got further", "both fail at the same depth"],
)
def test_the_newest_sample_of_each_step_is_that_of_the_result(scene, monkeypatch, furthest_mm, steps):
    fail_beyond(monkeypatch, furthest_mm)
    march = March(scene, SPHERE, pose()[0], PATH)
    samples = list(march)
    assert [sample.step for sample in samples] == steps
    [expected] = press(scene, [SPHERE], pose(), DEPTHS)
    assert_same(march.result, expected)
    for step, outputs in newest(samples).items():
        np.testing.assert_array_equal(outputs["displacement"], expected.displacement[step])


def test_without_a_touch_there_are_no_samples(scene):
    march = March(scene, SPHERE, pose(x=30.0)[0], PATH)
    assert list(march) == [] and march.touch_pose is None
    assert (march.result.status == Status.NEVER_TOUCHES).all()


def test_a_bad_path_is_refused(scene):
    with pytest.raises(InputError, match="path of shape"):
        March(scene, SPHERE, pose()[0], np.zeros((0, 3)))
    with pytest.raises(InputError, match="steps"):
        March(scene, SPHERE, pose()[0], PATH, steps=3)
