"""A worker presses as `press` does, can be stopped, and ends with its parent."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from simgen.fem.nonlinear.status import Status
from simgen.pipeline.plan import make_plan
from simgen.sensors.indenter import load_indenter
from simgen.sensors.sensor import load_sensor
from simgen.simulation.press import Scene, press
from simgen.view.press_events import DepthReached, Lost, PressEnded, Ready, Refused, Stopped, Touched
from simgen.view.press_worker import PressWorker
from view.live import depths_of, events_until, job_at

TESTS = Path(__file__).parents[1]
SLOW_JOB = {"depths": 300}  # a step of a micrometre; minutes


@pytest.fixture(scope="module")
def worker():
    worker = PressWorker()
    worker.prepare(job_at(), "digit")
    [ready] = events_until(worker)
    assert isinstance(ready, Ready) and ready.sensor == "digit" and ready.seconds > 0.0
    yield worker
    worker.close()


def pressed(job, sensor="digit"):
    """The result of `press` for the pose that the job's plan has."""
    arrays = make_plan(job).arrays
    pose = np.linalg.inv(arrays[f"{sensor}/pose"]) @ arrays["press/contact_pose"]
    own = load_sensor(sensor, mesh="coarse")
    return press(Scene(own, own.materials["solid"]), [load_indenter("ring_7mm").shape()], pose, job.depths_m)[0], pose[
        0
    ]


@pytest.fixture(scope="module")
def expected():
    return pressed(job_at())


def assert_as_expected(events, number, expected):
    result, pose = expected
    touched, *depths, ended = events
    assert isinstance(touched, Touched) and isinstance(ended, PressEnded)
    assert {event.press for event in events} == {number}
    assert [depth.step for depth in depths] == [0, 1, 2]
    seconds = [depth.seconds for depth in depths]
    assert seconds[0] > 0.0 and seconds == sorted(seconds) and seconds[-1] <= ended.seconds
    assert (ended.status, ended.reached, ended.touch_m) == (Status.CONVERGED, 3, result.touch)
    assert ended.sentence == Status.CONVERGED.sentence
    np.testing.assert_allclose(touched.pose[:3, :3], pose[:3, :3])
    np.testing.assert_allclose(touched.pose[:3, 3], pose[:3, 3] + result.touch * pose[:3, 1], rtol=0.0, atol=1e-12)
    for depth in depths:
        assert depth.outputs.keys() == result.outputs.keys()
        for name, value in depth.outputs.items():
            np.testing.assert_array_equal(value, result.outputs[name][depth.step], err_msg=name)


def test_a_live_press_has_the_bytes_of_press(worker, expected):
    number = worker.press(job_at(), "digit")
    assert_as_expected(events_until(worker), number, expected)
    assert worker.poll() == []


def test_a_stopped_press_ends_soon_and_the_next_one_is_right(worker, expected):
    number = worker.press(job_at(**SLOW_JOB), "digit")
    assert depths_of(events_until(worker, DepthReached))
    begin = time.perf_counter()
    worker.stop()
    events = events_until(worker)
    assert time.perf_counter() - begin < 1.0
    assert events[-1] == Stopped(number)
    number = worker.press(job_at(), "digit")
    assert_as_expected(events_until(worker), number, expected)


def test_a_press_stops_the_one_before(worker, expected):
    first = worker.press(job_at(**SLOW_JOB), "digit")
    events_until(worker, DepthReached)
    second = worker.press(job_at(), "digit")
    events = events_until(worker, PressEnded)
    own = [event for event in events if event.press == first]
    assert own[-1] == Stopped(first) and second == first + 1
    assert_as_expected(events[len(own) :], second, expected)


def test_a_stop_without_a_press_changes_nothing(worker, expected):
    worker.stop()
    number = worker.press(job_at(), "digit")
    assert_as_expected(events_until(worker), number, expected)


def test_a_contact_that_does_not_fit_is_refused_with_its_sentence(worker):
    number = worker.press(job_at(x_mm=4.0, depth_mm=1.0), "digit")
    [refused] = events_until(worker)
    assert isinstance(refused, Refused) and refused.press == number
    assert refused.sentence.startswith("trajectories.contacts[0] (x_mm 4, arc_mm 0): a side wall of digit is nearer ")
    worker.prepare(job_at(materials={"digit": {"preset": "foam"}}), "digit")
    assert events_until(worker) == [
        Refused(0, "sensors.digit.material: 'foam' is not a preset; allowed: solid"),
    ]


def test_another_material_is_pressed_as_such(worker):
    worker.press(job_at(materials={"digit": {"youngs_modulus_pa": 1.078e6}}), "digit")
    stiff = depths_of(events_until(worker))
    worker.press(job_at(), "digit")
    soft = depths_of(events_until(worker))
    np.testing.assert_allclose(stiff[-1].outputs["force"], 2.0 * soft[-1].outputs["force"], rtol=1e-12)


@pytest.mark.slow
def test_the_second_sensor_of_a_pair_is_pressed_where_the_plan_puts_it(worker):
    job = job_at(sensors=("digit", "biotac"))
    worker.press(job, "biotac")
    touched, *depths, ended = events_until(worker)
    result, pose = pressed(job, "biotac")
    np.testing.assert_allclose(touched.pose[:3, :3], pose[:3, :3])
    assert ended.touch_m == result.touch
    np.testing.assert_array_equal([depth.outputs["displacement"] for depth in depths], result.displacement)


def test_close_ends_the_process_within_a_press():
    worker = PressWorker()
    worker.press(job_at(**SLOW_JOB), "digit")
    events_until(worker, DepthReached)
    process = psutil.Process(worker._process.pid)
    worker.close()
    assert not process.is_running()
    assert worker.press(job_at(), "digit") == 2  # does nothing
    worker.stop()
    assert not [event for event in worker.poll() if isinstance(event, Lost)]


def test_a_worker_that_dies_is_lost():
    worker = PressWorker()
    os.kill(worker._process.pid, signal.SIGKILL)
    assert events_until(worker) == [Lost("the worker process has ended with exit code -9")]
    worker.press(job_at(), "digit")  # no error: `Lost` has said so
    worker.close()


PARENT = """
from view.live import events_until, job_at
from simgen.view.press_events import DepthReached
from simgen.view.press_worker import PressWorker
import time

if __name__ == "__main__":
    worker = PressWorker()
    worker.press(job_at(depths=300), "digit")
    events_until(worker, DepthReached)
    print(worker._process.pid, flush=True)
    time.sleep(600)
"""


def test_a_worker_ends_when_its_parent_is_killed(tmp_path):
    script = tmp_path / "parent.py"
    script.write_text(PARENT)
    paths = os.pathsep.join([str(TESTS), str(TESTS.parent), os.environ.get("PYTHONPATH", "")])
    parent = subprocess.Popen(
        [sys.executable, str(script)], stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": paths}
    )
    try:
        worker = psutil.Process(int(parent.stdout.readline()))
        assert worker.is_running()
    finally:
        parent.kill()
        parent.wait()
    gone, _ = psutil.wait_procs([worker], timeout=5.0)
    assert gone == [worker]
