"""The audit of a sensor's geometry measures what was changed, by as much as it was changed."""

import shutil

import fake
import numpy as np
import pytest

from simgen.dataset.contact_patch import FACET_M
from simgen.dataset.reader import Dataset
from simgen.dataset.touch_audit import allowed_m, displacements, pairing
from simgen.dataset.writer import create
from simgen.pipeline.run import run


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    job = fake.make_job(sensors={"digit": {"model": "digit"}}, trajectories={"count": 2})
    return run(fake.make_plan(job), tmp_path_factory.mktemp("sound") / "d.zarr", build=fake.fake_presser)


@pytest.fixture
def dataset(sound, tmp_path):
    shutil.copytree(sound.path, tmp_path / "d.zarr")
    return Dataset(tmp_path / "d.zarr")


def findings(check, dataset) -> dict:
    return {finding.what: finding for finding in check(Dataset(dataset.path), "digit")}


def test_a_contact_that_is_moved_outwards_is_off_by_that_distance(dataset):
    before = findings(pairing, dataset)
    assert all(finding.passed for finding in before.values())
    pose = dataset["press/contact_pose"][2]
    pose[:3, 3] *= 1.0 + 0.2e-3 / fake.RADIUS_M
    fake.change(dataset, "press/contact_pose", 2, pose)
    moved = findings(pairing, dataset)["contact distance"]
    assert not moved.passed and moved.note == "contact distance: press 2"
    # The contact lay up to a facet's sagitta outside the polyhedron already.
    assert 200.0 - 1e-6 <= float(moved.found.split()[0]) <= 200.0 + 1e6 * FACET_M


def test_a_normal_that_is_turned_is_off_by_that_angle(dataset):
    normal, pose = dataset["press/contact_normal"][1], dataset["press/contact_pose"][1]
    turned = np.cos(np.radians(30)) * normal + np.sin(np.radians(30)) * pose[:3, 0]
    fake.change(dataset, "press/contact_normal", 1, turned)
    found = findings(pairing, dataset)["contact angle"]
    assert float(found.found.split()[0]) == pytest.approx(30.0, abs=5.0) and found.note == "contact angle: press 1"


def test_a_held_vertex_that_moves_is_measured(dataset):
    assert all(finding.passed for finding in findings(displacements, dataset).values())
    fake.change(dataset, "digit/displacement", (3, 1, int(np.argmax(fake.HELD)), 2), 40)  # steps of 0.1 um
    found = findings(displacements, dataset)["held vertices move"]
    assert found.bad == ((3, 1),) and float(found.found.split()[0]) == pytest.approx(4e-6)


@pytest.mark.parametrize(
    ("vertex", "value", "bad"),
    [
        ("held", np.inf, "held vertices move"),
        ("held", 4e-6, "held vertices move"),
        ("free", np.nan, "displacement gaps"),
        ("free", np.inf, "displacement gaps"),
    ],
)
def test_displacements_in_metres_are_looked_at_too(vertex, value, bad, tmp_path):
    job = fake.make_job(
        sensors={"digit": {"model": "digit"}}, trajectories={"count": 1},
        dataset={"presses_per_shard": 2, "displacement": "float32"},
    )  # fmt: skip
    dataset = run(fake.make_plan(job), tmp_path / "f.zarr", build=fake.fake_presser)
    assert all(finding.passed for finding in findings(displacements, dataset).values())
    point = int(np.argmax(fake.HELD if vertex == "held" else ~fake.HELD))
    fake.change(dataset, "digit/displacement", (1, 2, point, 0), value)
    found = findings(displacements, dataset)[bad]
    assert not found.passed and found.bad == ((1, 2),)


def test_a_mesh_of_the_job_may_lie_2_percent_of_its_length_off_the_gel(sound, tmp_path):
    assert allowed_m(sound, "digit") == FACET_M
    choice = {"model": "digit", "output": {"file": "own.tet", "unit": "m"}}
    plan = fake.make_plan(fake.make_job(sensors={"digit": choice}))
    create(tmp_path / "o.zarr", plan.attributes, plan.arrays, plan.job)
    assert allowed_m(Dataset(tmp_path / "o.zarr"), "digit") == pytest.approx(FACET_M + 0.02 * 2 * fake.RADIUS_M)
