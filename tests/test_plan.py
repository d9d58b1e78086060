"""The plan: the job's settings are those of the modules that use them; bundled sensors make a sound plan."""

from dataclasses import asdict

import numpy as np
import pytest

from simgen.errors import InputError
from simgen.fem.newton import SolverSettings
from simgen.job import Solver, Trajectories, load_job
from simgen.pairing import ContactSettings
from simgen.plan import chosen_material, chosen_sensor, make_plan
from simgen.quiet import check_device


def test_the_job_and_the_solver_agree_on_names_and_defaults():
    assert Solver().model_dump(exclude={"element"}) == asdict(SolverSettings())


def test_the_job_and_the_pairing_agree_on_names_and_defaults():
    assert Trajectories(count=1).model_dump(exclude={"count"}) == asdict(ContactSettings())


@pytest.fixture(scope="module")
def plan():
    return make_plan(load_job("smoke.yaml"))


def test_presses_run_through_the_indenters_of_each_trajectory(plan):
    np.testing.assert_array_equal(plan.arrays["press/trajectory"], [0, 0, 0, 1, 1, 1])
    np.testing.assert_array_equal(plan.arrays["press/indenter"], [0, 1, 2, 0, 1, 2])


def test_the_reference_sensor_stays_where_it_is(plan):
    np.testing.assert_array_equal(plan.arrays["digit/pose"], np.tile(np.eye(4), (6, 1, 1)))
    assert not np.allclose(plan.arrays["biotac/pose"], np.eye(4))


def test_the_same_job_makes_the_same_plan(plan):
    again = make_plan(load_job("smoke.yaml"))
    assert again.attributes == plan.attributes
    for name, values in plan.arrays.items():
        np.testing.assert_array_equal(again.arrays[name], values, err_msg=name)


def test_more_trajectories_leave_the_first_ones_alone(plan):
    more = make_plan(load_job("smoke.yaml", ["trajectories.count=5"]))
    np.testing.assert_array_equal(more.arrays["press/contact_pose"][:6], plan.arrays["press/contact_pose"])


def test_a_material_is_a_preset_with_the_values_of_the_job_in_its_place():
    job = load_job("smoke.yaml", ["sensors.digit.material.friction=0.3"])
    material = chosen_material(job, "digit", chosen_sensor(job, "digit"))
    assert (material.youngs_modulus_pa, material.poisson_ratio, material.friction) == (539e3, 0.499, 0.3)


def test_an_unknown_preset_names_those_that_there_are():
    job = load_job("smoke.yaml", ["sensors.biotac.material=liquid"])
    with pytest.raises(InputError, match=r"sensors\.biotac\.material: 'liquid' .*allowed: .*effective"):
        chosen_material(job, "biotac", chosen_sensor(job, "biotac"))


@pytest.mark.parametrize(("gpus", "device", "says"), [
    (0, "cuda", "'cuda': this machine has no CUDA GPU; allowed here: cpu$"),
    (2, "cuda:2", "'cuda:2': this machine has cuda:0, cuda:1; allowed here: cpu, cuda$"),
    (2, "cuda:", "'cuda:' is not allowed; allowed: cpu, cuda, cuda:N"),
])  # fmt: skip
def test_a_device_that_is_not_there_is_refused(monkeypatch, gpus, device, says):
    monkeypatch.setattr("warp.get_cuda_device_count", lambda: gpus)
    with pytest.raises(InputError, match=says):
        make_plan(load_job("smoke.yaml"), device)


def test_devices_that_are_there_are_accepted(monkeypatch):
    monkeypatch.setattr("warp.get_cuda_device_count", lambda: 2)
    for device in ("cpu", "cuda", "cuda:0", "cuda:1"):
        check_device(device)
