"""Result files: round trips in both layouts, what the published readers find, and one line on each bad file."""

import fake
import h5py
import numpy as np
import pytest

from simgen.dataset import Dataset
from simgen.errors import InputError
from simgen.exchange import ResultFile, Sample, dataset_samples, export, is_result_file, write
from simgen.run import run

# Coordinates are stored in float32: half a unit in the last place of the largest, 8 mm.
STORED = 0.5 * np.spacing(np.float32(8e-3))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Four trajectories, three indenters, four depths; the ring stalls from the third depth on."""
    path = tmp_path_factory.mktemp("exchange") / "fake.zarr"
    run(fake.make_plan(fake.make_job()), path, build=fake.failing_presser)
    return Dataset(path)


@pytest.mark.parametrize("layout", ["across", "biotac_sim"])
def test_what_is_exported_is_read_back(dataset, layout, tmp_path):
    files = export(dataset, "biotac", layout, tmp_path, trajectories=[0, 2])
    assert len(files) == (1 if layout == "across" else 2)
    expected = list(dataset_samples(dataset, "biotac", [0, 2]))
    assert len(expected) == 2 * (4 + 2 + 4)
    read = []
    for file in files:
        with ResultFile(file) as opened:
            assert (opened.layout, opened.sensor) == (layout, "biotac")
            read += list(opened)
    key = [(s.env, s.step) for s in read]
    assert sorted(key) == sorted((s.env, s.step) for s in expected)
    if layout == "across":
        assert {s.trial for s in read} == {0, 2}
    for theirs in read:
        ours = next(s for s in expected if (s.env, s.step) == (theirs.env, theirs.step)
                and np.array_equal(s.force, theirs.force))  # fmt: skip
        assert np.abs(theirs.nodal_coordinates - ours.nodal_coordinates).max() <= STORED
        np.testing.assert_array_equal(theirs.pose, ours.pose)
        assert (theirs.indenter, theirs.depth_m) == (ours.indenter, ours.depth_m)


def test_samples_are_those_of_the_dataset(dataset):
    """Against the stand-in press itself: displacement along the press axis, pose where the indenter then is."""
    sample = next(s for s in dataset_samples(dataset, "digit", [1]) if s.indenter == "sphere_7mm" and s.step == 3)
    press = int(np.flatnonzero((dataset["press/trajectory"] == 1) & (dataset["press/indenter"] == 0))[0])
    contact = dataset["press/contact_pose"][press]
    moved = np.linalg.norm(sample.nodal_coordinates - fake.VERTICES, axis=1)
    assert moved.max() == pytest.approx(0.4e-3, rel=0.15)
    assert sample.depth_m == pytest.approx(0.4e-3)
    travel = (sample.pose[:3, 3] - contact[:3, 3]) @ contact[:3, 1]
    assert travel == pytest.approx(1e-5 + 0.4e-3)  # the stand-in touches 10 um beyond the contact's pose


def test_the_published_loader_finds_its_keys(dataset, tmp_path):
    """Keys as the loader of the ACROSS framework spells them (Mesh_Reconstruction, mesh_data_loader.py)."""
    (path,) = export(dataset, "digit", "across", tmp_path, trajectories=[1])
    assert path.name == "results_digit_fake.hdf5"
    with h5py.File(path) as file:
        assert file["trial_1"]["step_3"]["nodal_coords_digit"]["env_2"][:].shape == (len(fake.VERTICES), 3)
        assert file["trial_1"]["step_3"]["net_force_vecs_digit"]["env_2"][:].shape == (3,)
        assert file["trial_1/step_3/max_contact_distances/env_2"][()] == pytest.approx(0.4e-3)
        assert "env_1" not in file["trial_1/step_2/nodal_coords_digit"]  # the ring did not get there
    (path,) = export(dataset, "digit", "biotac_sim", tmp_path, trajectories=[1])
    with h5py.File(path) as file:
        assert file["step_0/nodal_coords/env_0"][:].shape == (len(fake.VERTICES), 3)
        assert file["step_0/net_force_vecs/env_0"][:].shape == (3,)


def test_a_file_of_others_has_neither_poses_nor_names(tmp_path):
    with h5py.File(tmp_path / "results.hdf5", "w") as file:
        for step in (10, 9):
            file[f"step_{step}/nodal_coords/env_0"] = np.full((5, 3), step)
            file[f"step_{step}/net_force_vecs/env_0"] = np.zeros(3)
            file[f"step_{step}/elem_stresses/env_0"] = np.zeros(7)
    with ResultFile(tmp_path / "results.hdf5") as opened:
        assert opened.layout == "biotac_sim" and opened.sensor is None
        assert opened.presses() == {(0, 0): [9, 10]}  # by number, not by spelling
        sample = opened.sample(0, 0, 10)
    assert (sample.indenter, sample.pose, sample.depth_m) == (None, None, None)
    assert (sample.nodal_coordinates == 10).all()


def spoiled(folder, key, values):
    """A file in the ACROSS layout with one array replaced, or missing."""
    path = folder / "results_digit_job.hdf5"
    write(path, "across", "digit", [Sample(0, 0, 0, np.zeros((5, 3)), np.zeros(3))], {})
    with h5py.File(path, "a") as file:
        del file[key]
        if values is not None:
            file[key] = values
    return path


@pytest.mark.parametrize(
    "key, values, complaint",
    [
        ("trial_0", None, "neither trial_<i> (ACROSS) nor step_<j> (biotac_sim)"),
        ("trial_0/step_0/nodal_coords_digit", None, "trial_0/step_0/nodal_coords_digit: not there"),
        ("trial_0/step_0/nodal_coords_digit/env_0", None, "no env_<k> in any nodal_coords"),
        ("trial_0/step_0/net_force_vecs_digit", None, "trial_0/step_0/net_force_vecs_digit/env_0: not there"),
        ("trial_0/step_0/nodal_coords_digit/env_0", np.zeros((3, 5)), "shape (3, 5), expected (vertex, 3) in m"),
        ("trial_0/step_0/nodal_coords_digit/env_0", np.full((5, 3), np.nan), "not finite"),
        ("trial_0/step_0/net_force_vecs_digit/env_0", np.zeros(2), "shape (2,), expected (3,) in N"),
    ],
)
def test_bad_files_are_one_clear_line(tmp_path, key, values, complaint):
    path = spoiled(tmp_path, key, values)
    with pytest.raises(InputError) as raised, ResultFile(path) as opened:
        list(opened)
    assert complaint in str(raised.value)
    assert str(path) in str(raised.value) and "\n" not in str(raised.value)


def test_what_is_no_result_file(tmp_path):
    text = tmp_path / "text.hdf5"
    text.write_text("no HDF5")
    assert not is_result_file(text)
    with pytest.raises(InputError, match="cannot be read as HDF5"):
        ResultFile(text)
    with pytest.raises(InputError, match="cannot be read as HDF5"):
        ResultFile(tmp_path / "missing.hdf5")
    with h5py.File(tmp_path / "electrodes.hdf5", "w") as file:
        file["electrode_vals/data"] = np.zeros((2, 19))
    assert not is_result_file(tmp_path / "electrodes.hdf5")


def test_bad_requests(dataset, tmp_path):
    with pytest.raises(InputError, match="layout 'vtk': allowed: across, biotac_sim"):
        export(dataset, "digit", "vtk", tmp_path, [0])
    with pytest.raises(InputError, match="sensor 'finger': allowed: digit, biotac"):
        export(dataset, "finger", "across", tmp_path, [0])
    samples = [Sample(trial, 0, 0, np.zeros((5, 3)), np.zeros(3)) for trial in (0, 1)]
    with pytest.raises(InputError, match="one per file"):
        write(tmp_path / "two.hdf5", "biotac_sim", "digit", samples, {})
    assert not (tmp_path / "two.hdf5").exists()
