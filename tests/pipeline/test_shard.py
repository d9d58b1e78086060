"""Shards: a worker presses only with the code, the packages, the sensors and the indenters of the dataset."""

import os
import re
import shutil
import subprocess
import sys
import threading
from functools import partial
from pathlib import Path

import fake
import numpy as np
import pytest
import trimesh

from simgen.config.job import load_job
from simgen.config.job_schema import Job
from simgen.dataset.audit import check, passes
from simgen.dataset.provenance import code_version, package_versions
from simgen.dataset.reader import Dataset
from simgen.dataset.writer import open_or_create
from simgen.fem.device import DEVICE
from simgen.pipeline import presser, shard
from simgen.pipeline.plan import indenter_identities, make_plan, sensor_identity
from simgen.pipeline.run import run
from simgen.sensors.indenter import chosen_indenters, load_indenter
from simgen.sensors.sensor import load_sensor
from simgen.simulation.error_estimate import share_of_difference, surface_error_estimate
from simgen.simulation.press import Scene, press


def test_a_worker_with_another_indenter_file_writes_nothing(tmp_path):
    block = trimesh.creation.box([8e-3, 4e-3, 6e-3])
    block.export(tmp_path / "block.stl")
    plan = fake.make_plan(fake.make_job(indenters=[str(tmp_path / "block.stl")]))
    reports = []
    block.apply_scale(1.1).export(tmp_path / "block.stl")
    path = tmp_path / "d.zarr"
    dataset = run(plan, path, on_report=reports.append, build=fake.fake_presser)
    assert dataset.finished() == []
    for report in reports:
        assert re.search(r"the inputs on .* differ from the dataset's \(indenters\.block\.sha256: ", report.error)


def test_a_worker_compares_what_it_has_loaded(tmp_path, monkeypatch):
    """Not what lies on the disk by now: its code may have been updated since it started."""
    monkeypatch.setattr("simgen.dataset.provenance.source_hash", lambda: "newer")
    plan, reports = fake.make_plan(fake.make_job()), []
    assert plan.attributes["code"]["source"] == "newer"
    dataset = run(plan, tmp_path / "d.zarr", on_report=reports.append, build=fake.fake_presser)
    assert dataset.finished() == [] and all("code.source: newer -> " in report.error for report in reports)


@pytest.mark.parametrize("what, key", [("packages", "warp-lang"), ("code", "source")])
def test_a_worker_with_another_version_writes_nothing(tmp_path, what, key):
    """As on a machine where another one is installed."""
    plan, reports = fake.make_plan(fake.make_job()), []
    plan.attributes = {**plan.attributes, what: {**plan.attributes[what], key: "0.1"}}
    dataset = run(plan, tmp_path / "d.zarr", on_report=reports.append, build=fake.fake_presser)
    assert dataset.finished() == []
    assert all(re.search(rf"differ from the dataset's \({what}\.{key}: 0\.1 -> ", report.error) for report in reports)


def test_a_dataset_finds_its_indenter_again_from_anywhere(tmp_path, monkeypatch):
    """By the folder of the job file, which a run writes down beside its times."""
    (tmp_path / "jobs").mkdir()
    trimesh.creation.box([8e-3, 4e-3, 6e-3]).apply_translation([0, -2e-3, 0]).export(tmp_path / "jobs/block.stl")
    job = fake.make_job(indenters=["./block.stl"])
    job._folder = tmp_path / "jobs"
    dataset = run(fake.make_plan(job), tmp_path / "d.zarr", build=fake.fake_presser)
    monkeypatch.chdir("/")
    again = Dataset(dataset.path)
    assert again.job.locate("./block.stl") == tmp_path / "jobs/block.stl"
    assert indenter_identities(chosen_indenters(again.job)) == again.attributes["indenters"]


def test_a_worker_with_another_mesh_writes_nothing(tmp_path):
    plan = fake.make_plan(fake.make_job(sensors={"digit": {"model": "digit", "mesh": "coarse"}}))
    own = sensor_identity(plan.job, "digit", load_sensor("digit", "coarse"))
    for name, mesh, written in (("same", own["simulation_mesh"], 6), ("other", "0" * 64, 0)):
        attributes = {**plan.attributes, "sensors": {"digit": {**own, "simulation_mesh": mesh}}}
        plan.attributes = attributes
        reports = []
        path = tmp_path / f"{name}.zarr"
        dataset = run(plan, path, on_report=reports.append, build=fake.fake_presser)
        assert len(dataset.finished()) == written
    assert all(f"sensors.digit.simulation_mesh: {mesh} -> {own['simulation_mesh']}" in r.error for r in reports)


def test_what_was_checked_last_is_what_is_pressed(monkeypatch):
    """A worker that solves for two datasets in turn, between which the sensor's files change and change back."""
    job, files = fake.make_job(), {}
    monkeypatch.setattr("simgen.pipeline.presser.chosen_sensor", lambda job, name: files[name])
    monkeypatch.setattr("simgen.pipeline.shard.sensor_identity", lambda job, name, sensor: {"mesh": sensor})
    for mesh in ("one", "other", "one"):
        files["digit"] = mesh
        indenters = indenter_identities(chosen_indenters(job))
        here = {"code": code_version(), "packages": package_versions(), "indenters": indenters}
        shard._check_inputs(job, shard.recorded_inputs({**here, "sensors": {"digit": {"mesh": mesh}}}))
        assert presser.loaded_sensor(job, "digit") == mesh
    presser.loaded_sensor.cache_clear()
    shard._inputs.cache_clear()


def test_pressers_are_told_how_many_steps_leave_enough_gel(tmp_path):
    """By press, whatever the shards; a job that draws contacts again tells them nothing."""
    told = []

    def build(job, sensor, device):
        def presser(indenters, poses, *steps):
            told.append((sensor, steps))
            return fake.fake_presser(job, sensor, device)(indenters, poses)

        return presser

    plan = fake.make_plan(fake.make_job(trajectories={"count": 2, "too_thin": "stop"}))
    steps = {"digit": np.array([4, 0, 2, 3, 1, 4], np.int32), "biotac": np.array([4, 4, 3, 2, 1, 0], np.int32)}
    plan.arrays |= {f"{name}/pressable_steps": own for name, own in steps.items()}
    dataset = run(plan, tmp_path / "d.zarr", build=build)
    for name, own in steps.items():
        np.testing.assert_array_equal(np.concatenate([each[0] for sensor, each in told if sensor == name]), own)
    assert passes(check(dataset))
    told.clear()
    run(fake.make_plan(fake.make_job()), tmp_path / "e.zarr", build=build)
    assert told and not any(steps for _, steps in told)


@pytest.mark.slow
def test_error_estimates_come_from_the_coarser_mesh_and_the_energy(tmp_path):
    """With linear elements, which are fast and far off; the coarser mesh is part of the sensor's identity."""
    names = ["surface_error_estimate_m", "force_error_estimate"]
    job = load_job("smoke", ["sensors={digit: {model: digit, mesh: default}}", "indenters=[sphere_7mm]",
                             "trajectories.count=1", "depths_mm={first: 0.1, last: 0.2, count: 2}",
                             "solver.element=P1", f"outputs={{digit: [{', '.join(names)}]}}"])  # fmt: skip
    dataset = run(make_plan(job), tmp_path / "d.zarr")
    surface, force = (dataset[f"digit/{name}"][0] for name in names)
    assert (surface > 0.0).all() and (force > 0.01).all()
    coarse = load_sensor("digit", "coarse")
    assert dataset.attributes["sensors"]["digit"]["coarser_mesh"] == coarse.simulation_mesh.hash
    poses = np.linalg.inv(dataset["digit/pose"]) @ dataset["press/contact_pose"]
    scenes = [Scene(each, each.materials["solid"], settings=job.solver, outputs=("error_energy",))
              for each in (coarse, load_sensor("digit"))]  # fmt: skip
    shapes = [load_indenter("sphere_7mm").shape()]
    coarser, own = [press(scene, shapes, poses, job.depths_m)[0] for scene in scenes]
    share = share_of_difference(scenes[0].unknowns, scenes[1].unknowns)
    by_hand = surface_error_estimate(own.displacement, coarser.displacement, share)
    np.testing.assert_allclose(surface, by_hand, rtol=1e-5)
    np.testing.assert_allclose(force, own.force_error_estimate, rtol=1e-5)


def test_tasks_share_what_they_read_of_the_plan_until_the_dataset_is_another(tmp_path):
    """A worker may live on while a dataset is removed and made again in the same place."""
    path, job = tmp_path / "d.zarr", fake.make_job()
    run(fake.make_plan(job), path, build=fake.fake_presser)
    first = shard._planned(path, job)
    assert shard._planned(path, job) is first
    shutil.rmtree(path)
    other = fake.make_job(seed=4)
    run(fake.make_plan(other), path, build=fake.fake_presser)
    second = shard._planned(path, other)
    assert not np.array_equal(second.contact_pose, first.contact_pose)
    np.testing.assert_array_equal(second.contact_pose, Dataset(path)["press/contact_pose"])


@pytest.mark.parametrize("prepared", [False, True])
def test_tasks_that_begin_together_make_each_presser_once(tmp_path, prepared):
    """Each takes gigabytes of a GPU. A thread that makes one lets others use the device while it waits for results."""
    job = fake.make_job(sensors={"digit": {"model": "digit", "mesh": "coarse"}})
    plan, path, made = fake.make_plan(job), tmp_path / "d.zarr", []
    own = {"digit": sensor_identity(job, "digit", load_sensor("digit", "coarse"))}  # as prepared
    open_or_create(path, {**plan.attributes, "sensors": own}, plan.arrays, job)

    another = threading.Event()

    def slow_presser(job: Job, sensor: str, device: str) -> presser.Presser:
        made.append(sensor)
        if len(made) > 1:
            another.set()
        with DEVICE.left():
            another.wait(timeout=0.5)
        return fake.fake_presser(job, sensor, device)

    tasks = [partial(shard.prepare, job, "cpu", slow_presser)] if prepared else []
    tasks += [partial(shard.run_shards, path, [i], job, "cpu", slow_presser) for i in range(job.shards)]
    threads = [threading.Thread(target=task, daemon=True) for task in tasks]  # a deadlock must not hang the tests
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=60.0)
    assert made == ["digit"] and not Dataset(path).unfinished()


def test_a_process_gets_ready_without_a_word(tmp_path):
    """Warp would warn of a machine without a GPU."""
    code = "import fake; from simgen.pipeline.shard import prepare; prepare(fake.make_job(), 'cpu', fake.fake_presser)"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(fake.__file__).parent), *sys.path])}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True)
    assert done.stdout + done.stderr == ""
