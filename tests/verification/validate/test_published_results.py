"""Result files, with and without poses, solved again."""

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simgen.config.job import job_from_dict
from simgen.dataset.exchange import ResultFile, Sample, write
from simgen.dataset.exchange.exporting import export
from simgen.errors import InputError
from simgen.pipeline.plan import make_plan
from simgen.pipeline.run import run
from simgen.sensors.sensor import load_sensor
from simgen.verification.validate.published_results import compare_results, indenter_of, to_sensor_frame
from simgen.verification.validate.published_sensors import mesh_with
from tests.verification.validate.fakes import outcome_of


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """One sphere on the DIGIT, two depths."""
    return solved("default", tmp_path_factory.mktemp("published"))


@pytest.fixture(scope="module")
def coarse(tmp_path_factory):
    """The same on its coarse mesh, which is faster; the output mesh is that of all its simulation meshes."""
    return solved("coarse", tmp_path_factory.mktemp("coarse"))


def solved(mesh, folder):
    job = job_from_dict({
        "name": "tiny",
        "seed": 3,
        "sensors": {"digit": {"model": "digit", "mesh": mesh}},
        "indenters": ["sphere_7mm"],
        "trajectories": {"count": 1},
        "depths_mm": {"first": 0.5, "last": 1.0, "count": 2},
    })  # fmt: skip
    return run(make_plan(job), folder / "tiny.zarr")


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["across", "biotac_sim"])
def test_an_own_file_is_reproduced(coarse, layout, tmp_path):
    """The same job and poses: only the stored precision differs, 0.1 um and float32."""
    export(coarse, layout, tmp_path / "own", ["digit"], "0")
    outcome = outcome_of("published-results", tmp_path, tmp_path)
    assert len(outcome.rows) == 1 + 2 * 2
    assert [row.quantity for row in outcome.rows if not row.passed] == []
    assert max(row.ours for row in outcome.rows if row.unit == "um") < 0.2
    results, poses = outcome.tables
    np.testing.assert_allclose(sorted(row[1] for row in results.rows), [0.5, 1.0], atol=1e-3)
    ((_, tip_um, axis_deg, touched, misfit_um),) = poses.rows
    print(f"recovered pose: {tip_um:.0f} um, {axis_deg:.2f} deg, {touched} vertices, {misfit_um:.1f} um")
    # Recovered from a mesh of 0.8 mm whose faces overlap the indenter by some 10 um.
    assert tip_um < 100.0 and axis_deg < 2.0


def anonymous(source: Path, target: Path) -> None:
    """Write the file as other programs do: no names, poses or job, and the sensor at another place."""
    motion, world = Rotation.from_euler("xyz", [10.0, -20.0, 30.0], degrees=True), np.array([0.0, 0.05, 0.0])
    with ResultFile(source) as file:
        samples = [
            Sample(s.trial, 1, s.step, world + motion.apply(s.nodal_coordinates), motion.apply(s.force)) for s in file
        ]
    write(target, "across", "digit", samples, {})
    with h5py.File(target, "a") as file:
        for key in list(file.attrs):
            del file.attrs[key]


@pytest.mark.slow
def test_a_file_of_others_is_placed_and_its_pose_recovered(dataset, tmp_path):
    """The press at the recovered pose is within the errors that the project allows a mesh."""
    export(dataset, "across", tmp_path / "own", ["digit"], "0")
    own = tmp_path / "own" / f"results_digit_{dataset.job.name}.hdf5"
    published = tmp_path / "published"
    published.mkdir()
    anonymous(own, published / "results_digit_x.hdf5")
    outcome = compare_results(published, "cpu")
    (fixed,) = outcome.rows
    assert fixed.passed and fixed.ours < 0.1
    results, poses = outcome.tables
    assert len(results.rows) == 2 and poses.rows[0][1] == ""
    for row in results.rows:
        print(f"depth {row[1]:.3f} mm, force {row[4]:+.2f} %, RMSE of the region {row[7]:.2f} um")
        assert abs(row[4]) < 2.0  # %: the travel of the contact is found to about 1 % of the depth
        assert row[7] < 5.0


def test_a_rigid_motion_is_undone():
    mesh = load_sensor("digit").output_mesh
    rng = np.random.default_rng(5)
    u = np.where(mesh.held[:, None], 0.0, rng.normal(scale=1e-4, size=mesh.vertices.shape))
    pose = np.eye(4)
    pose[:3, 3] = 1e-3 * np.array([1.0, -8.0, 2.0])
    sample = Sample(0, 0, 0, mesh.vertices + u, np.array([0.1, 2.0, -0.3]), pose=pose)
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_euler("xyz", [0.4, -1.1, 2.0]).as_matrix()
    motion[:3, 3] = 0.05, -0.02, 0.3
    away = replace(
        sample,
        nodal_coordinates=sample.nodal_coordinates @ motion[:3, :3].T + motion[:3, 3],
        force=motion[:3, :3] @ sample.force,
        pose=motion @ pose,
    )
    back, off_um = to_sensor_frame(away, mesh)
    assert off_um < 1e-6
    np.testing.assert_allclose(back.nodal_coordinates, sample.nodal_coordinates, atol=1e-12)
    np.testing.assert_allclose(back.force, sample.force, atol=1e-12)
    np.testing.assert_allclose(back.pose, sample.pose, atol=1e-12)


def test_vertices_in_another_order_are_found_out(tmp_path):
    """Vertices would be compared with wrong ones, and the held vertices of the file are not at rest."""
    mesh = load_sensor("digit").output_mesh
    shuffled = mesh.vertices[np.random.default_rng(1).permutation(len(mesh.vertices))]
    write(tmp_path / "results.hdf5", "across", "digit", [Sample(0, 0, 0, shuffled, np.ones(3))], {})
    outcome = compare_results(tmp_path, "cpu")
    assert not outcome.rows[0].passed
    assert "not solved" in outcome.notes[-1]


def test_which_indenter():
    nothing = np.zeros((1, 3)), np.zeros(3)
    assert indenter_of(Sample(0, 7, 0, *nothing), None).name == "ring_7mm"
    assert indenter_of(Sample(0, 0, 0, *nothing, indenter="cube_14mm"), None).name == "cube_14mm"
    with pytest.raises(InputError, match="env_9: names no indenter"):
        indenter_of(Sample(0, 9, 0, *nothing), None)


def test_unknown_meshes_are_one_line(tmp_path):
    with pytest.raises(InputError, match=r"no mesh of 7 vertices \(.*\.tet\)") as raised:
        mesh_with("digit", 7, tmp_path)
    assert str(tmp_path) in str(raised.value)
    write(tmp_path / "results.hdf5", "across", "finger", [Sample(0, 0, 0, np.zeros((7, 3)), np.ones(3))], {})
    with pytest.raises(InputError, match="sensor 'finger' without the job that made it; allowed: digit, biotac"):
        compare_results(tmp_path, "cpu")


def test_a_job_that_does_not_fit_its_file(tmp_path):
    job = {"name": "x", "sensors": {"digit": {"model": "digit"}}, "indenters": ["sphere_7mm"],
           "trajectories": {"count": 1}, "depths_mm": {"first": 0.1, "last": 0.1, "count": 1}}  # fmt: skip
    sample = Sample(0, 0, 0, np.zeros((7, 3)), np.ones(3))
    write(tmp_path / "results.hdf5", "across", "digit", [sample], {"job": json.dumps(job)})
    with pytest.raises(InputError, match=r"7 vertices, but the sensor of its job has \d+"):
        compare_results(tmp_path, "cpu")
