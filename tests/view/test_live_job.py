"""Jobs of live presses: what they keep, their files, and their datasets."""

import re
from dataclasses import replace

import numpy as np
import pytest
import trimesh
import yaml

from simgen.config.job import load_job
from simgen.dataset.audit import check, passes
from simgen.dataset.reader import Dataset
from simgen.errors import InputError
from simgen.sensors.indenter import chosen_indenters
from simgen.view.live_job import PressChoices, base_from_file, base_job, live_job, save_dataset, write_job
from simgen.view.press_inputs import PressInputs

CONTACT = {"x_mm": -6.0, "arc_mm": 1e-5, "tilt_deg": 3.0, "azimuth_deg": -40.0, "roll_deg": 20.0}
CHOICES = PressChoices(CONTACT, "ring_7mm", 0.3, 3)


@pytest.fixture
def folder(tmp_path):
    """A folder with a job of own files: a sensor, an indenter and an output mesh, by relative paths."""
    own = tmp_path / "jobs"
    own.mkdir()
    trimesh.creation.icosphere(subdivisions=2, radius=3.0).export(own / "ball.stl")
    job = {
        "name": "own",
        "sensors": {
            "mine": {"model": "./gel", "output": {"file": "skin.vtu", "unit": "mm"}},
            "digit": {"model": "digit"},
        },
        "indenters": ["sphere_7mm", {"file": "./ball.stl", "unit": "mm", "spacing_mm": 0.3}],
        "trajectories": {"count": 7, "least_thickness_left": 0.0, "max_force_n": 5.0, "max_tilt_deg": 2.0},
        "depths_mm": {"first": 0.2, "last": 0.8, "count": 4},
        "outputs": {"mine": ["traction", "surface_error_estimate_m", "force_error_estimate"]},
        "solver": {"contact_tolerance": 0.01},
        "dataset": {"leave_out": "ball", "presses_per_shard": 3, "license": "CC0-1.0", "output": "there.zarr"},
    }
    (own / "own.yaml").write_text(yaml.safe_dump(job, sort_keys=False))
    return own


def test_a_job_file_s_sensors_depths_solver_and_outputs_stay(folder):
    own = load_job(folder / "own.yaml")
    job = live_job(base_from_file(folder / "own.yaml"), PressChoices(CONTACT, "ball", 0.8, 4))
    assert job.depths_mm == own.depths_mm and job.solver == own.solver and job.name == "own"
    assert list(job.sensors) == ["mine", "digit"]
    assert job.sensors["mine"].model == str(folder / "gel")
    assert job.sensors["mine"].output.file == str(folder / "skin.vtu")
    assert job.sensors["digit"] == own.sensors["digit"]
    assert job.indenters[0].file == str(folder / "ball.stl") and job.indenter_names == ("ball",)
    assert (job.indenters[0].unit, job.indenters[0].spacing_mm) == ("mm", 0.3)
    assert job.outputs == {"mine": ("traction", "force_error_estimate")}  # live presses have no coarser mesh
    assert (job.trajectories.least_thickness_left, job.trajectories.max_force_n) == (0.0, 5.0)
    assert job.trajectories.count == 1 and job.trajectories.contacts[0].model_dump() == CONTACT
    assert job.dataset.displacement == "float32" and job.dataset.leave_out is None


def test_choices_replace_depths_meshes_and_materials():
    base = base_job(["digit", "biotac"], ["ring_7mm", "sphere_7mm"], outputs=["traction"])
    materials = {"biotac": {"preset": "effective", "friction": 0.2}}
    job = live_job(base, replace(CHOICES, mesh="default", materials=materials))
    assert job.depths_m.tolist() == [0.0001, 0.0002, 0.0003] and job.indenter_names == ("ring_7mm",)
    assert {sensor.mesh for sensor in job.sensors.values()} == {"default"}
    assert job.sensors["digit"].material.preset == "solid"
    assert (job.sensors["biotac"].material.preset, job.sensors["biotac"].material.friction) == ("effective", 0.2)
    assert job.outputs == {"digit": ("traction",), "biotac": ("traction",)}
    assert {sensor.mesh for sensor in live_job(base, CHOICES).sensors.values()} == {"coarse"}


def test_own_sensors_and_indenters_by_path(folder, monkeypatch):
    monkeypatch.chdir(folder)
    base = base_job(["digit", "./gel"], ["./ball.stl", "ring_7mm"], unit="mm")
    assert base.sensors["gel"].model == str(folder / "gel") and base.indenter_names == ("ball", "ring_7mm")
    job = live_job(base, replace(CHOICES, indenter="ball"))
    monkeypatch.chdir("/")
    [indenter] = chosen_indenters(job)
    np.testing.assert_allclose(indenter.extent, [[-3e-3] * 3, [3e-3] * 3], atol=2e-5)
    with pytest.raises(InputError, match=r"sensor digit: digit is given twice; allowed: "):
        base_job(["digit", "digit"], ["ring_7mm"])


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"depth_mm": 20.0}, "the press: depths_mm.last: 20.0 is not allowed; allowed: above 0, to 10 mm"),
        ({"depths": 0}, "the press: depths_mm.count: 0 is not allowed; allowed: a whole number, 1 to 1000"),
        ({"materials": {"digit": {"friction": 3.0}}},
         "the press: sensors.digit.material.friction: 3.0 is not allowed; allowed: 0 to 2"),
        ({"mesh": "best"}, 'the press: sensors.digit.mesh: "best" is not allowed; allowed: default, coarse or fine'),
        ({"contact": {"x_mm": 0.0, "arc_mm": 0.0, "tilt_deg": 60.0}},
         "the press: trajectories.contacts.0.tilt_deg: 60.0 is not allowed; allowed: 0 to 45 degrees"),
        ({"indenter": "hammer"}, "the press: indenter 'hammer' is not in the job; allowed: ring_7mm"),
    ],
)  # fmt: skip
def test_a_choice_out_of_range_is_refused(changes, line):
    with pytest.raises(InputError) as caught:
        live_job(base_job(["digit"], ["ring_7mm"]), replace(CHOICES, **changes))
    assert re.fullmatch(re.escape(line), str(caught.value))


def test_a_written_job_is_the_same_job(folder, tmp_path):
    jobs = [
        live_job(base_job(["digit", "biotac"], ["ring_7mm"]), CHOICES),
        live_job(base_from_file(folder / "own.yaml"), PressChoices(CONTACT, "ball", 0.7, 9, mesh="fine")),
        live_job(base_from_file("shear_twist"), PressChoices(CONTACT, "sphere_7mm")),
    ]
    for number, job in enumerate(jobs):
        file = tmp_path / f"{number}.yaml"
        write_job(job, file)
        assert load_job(file).hash == job.hash
    with pytest.raises(InputError, match="no such folder"):
        write_job(jobs[0], tmp_path / "missing" / "job.yaml")


@pytest.mark.slow
def test_a_saved_press_is_the_live_press(tmp_path):
    job = live_job(base_job(["digit", "biotac"], ["ring_7mm"]), CHOICES)
    save_dataset(job, tmp_path / "d.zarr")
    dataset = Dataset(tmp_path / "d.zarr")
    assert dataset.job.hash == job.hash and dataset.presses == 1
    assert passes(check(dataset)), [finding for finding in check(dataset) if finding.failed]
    inputs = PressInputs("cpu")
    for sensor in job.sensors:
        for sample in inputs.march(job, sensor):
            stored = dataset.displacement(sensor, 0, sample.step)
            np.testing.assert_array_equal(stored, sample.outputs["displacement"].astype(np.float32))
            np.testing.assert_array_equal(dataset[f"{sensor}/force"][0, sample.step], sample.outputs["force"])
    other = live_job(base_job(["digit"], ["ring_7mm"]), CHOICES)
    with pytest.raises(InputError, match="holds another dataset"):
        save_dataset(other, tmp_path / "d.zarr")
