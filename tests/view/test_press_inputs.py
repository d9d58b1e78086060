"""What a process keeps between presses, and what a press takes from its job."""

import numpy as np
import pytest

from simgen.errors import InputError
from simgen.fem.nonlinear.status import Status
from simgen.pipeline import plan
from simgen.view import press_inputs
from simgen.view.live_job import PressChoices, base_from_file, base_job, live_job
from simgen.view.press_inputs import MOST_KEPT, PressInputs
from view.live import job_at

DIGIT = "sensors={digit: {model: digit, mesh: coarse}}"
MIDDLE = {"x_mm": -6.0, "arc_mm": 0.0}


@pytest.fixture(scope="module")
def inputs():
    return PressInputs("cpu")


def scene_of(inputs, job):
    return inputs.march(job, "digit")._stepping.scene


def test_a_scene_is_made_again_only_where_something_decides_so(inputs, monkeypatch):
    made = []
    real = press_inputs.Scene
    monkeypatch.setattr(press_inputs, "Scene", lambda *arguments: made.append(real(*arguments)) or made[-1])
    first = scene_of(inputs, job_at())
    assert scene_of(inputs, job_at(x_mm=-8.0, depths=2, depth_mm=0.2)) is first
    soft = scene_of(inputs, job_at(materials={"digit": {"friction": 0.1}}))
    assert soft is not first and soft.material.friction == 0.1
    assert scene_of(inputs, job_at()) is first and len(made) == 2


def test_the_last_few_are_kept():
    inputs, made = PressInputs("cpu"), []

    def keep(key):
        return inputs._keep("number", key, lambda: made.append(key) or key)

    for key in [*range(MOST_KEPT), 0, MOST_KEPT, 0]:
        assert keep(key) == key
    assert made == list(range(MOST_KEPT + 1))  # 0 was used again, and stayed
    keep(1)
    assert made[-1] == 1


def test_slow_outputs_are_measured_where_the_job_asks(inputs):
    choices = PressChoices(MIDDLE, "ring_7mm", 0.1, 1)
    for asked in ((), ("traction",)):
        job = live_job(base_job(["digit"], ["ring_7mm"], outputs=asked), choices)
        [sample] = inputs.march(job, "digit")
        assert {"traction", "stress"} & sample.outputs.keys() == {*asked}
    traction = sample.outputs["traction"]
    assert traction.shape[1] == 3 and np.abs(traction).max() > 1e3  # Pa


def test_the_path_and_the_limits_of_a_job_hold(inputs):
    legs = "trajectories={count: 1, max_force_n: 0.5, path: [{move_mm: [0.1, 0, 0], steps: 2}]}"
    base = base_from_file("smoke", [DIGIT, legs, "depths_mm={first: 0.1, last: 0.3, count: 3}"])
    march = inputs.march(live_job(base, PressChoices(MIDDLE, "ring_7mm", 0.3, 3)), "digit")
    steps = [sample.step for sample in march]
    assert len(march.result.status) == 5 and steps == [0]
    assert (march.result.status[1:] == Status.FORCE_LIMIT).all()


def test_a_press_ends_before_it_leaves_too_little_gel(inputs):
    thin = "trajectories={count: 1, too_thin: stop, least_thickness_left: 0.9}"
    job = live_job(base_from_file("smoke", [DIGIT, thin]), PressChoices(MIDDLE, "ring_7mm", 0.8, 8))
    march = inputs.march(job, "digit")
    reached = len(list(march))
    assert 0 < reached < 8 and (march.result.status[reached:] == Status.NO_ROOM).all()
    assert plan.make_plan(job).arrays["digit/pressable_steps"].tolist() == [reached]


def test_prepare_makes_the_scene(monkeypatch):
    inputs = PressInputs("cpu")
    job = job_at()
    inputs.prepare(job, "digit")
    monkeypatch.setattr(press_inputs, "Scene", None)  # not made again
    march = inputs.march(job, "digit")
    assert np.isfinite(march.touch_pose).all()


def test_prepare_does_not_mind_a_contact_that_does_not_fit():
    inputs = PressInputs("cpu")
    inputs.prepare(job_at(x_mm=4.0, depth_mm=1.0), "digit")
    with pytest.raises(InputError, match="side wall"):
        inputs.march(job_at(x_mm=4.0, depth_mm=1.0), "digit")
