"""Result files: what is written is read back in both layouts, and one line on each bad file."""

import h5py
import numpy as np
import pytest

from simgen.dataset.exchange import ResultFile, Sample, is_result_file, write
from simgen.dataset.exchange.selection import SensorSamples, select
from simgen.errors import InputError


@pytest.mark.parametrize("layout", ["across", "biotac_sim"])
def test_what_is_written_is_read_back(dataset, layout, tmp_path):
    expected = list(SensorSamples(dataset, "biotac").of(select(dataset, trajectories="2").presses))
    write(tmp_path / "results.hdf5", layout, "biotac", expected, {"job": "x"})
    # Half a unit in the last place of the largest coordinate, in float32.
    stored = 0.5 * np.spacing(np.float32(max(np.abs(sample.nodal_coordinates).max() for sample in expected)))
    with ResultFile(tmp_path / "results.hdf5") as opened:
        assert (opened.layout, opened.sensor, opened.attributes["job"]) == (layout, "biotac", "x")
        read = list(opened)
    assert len(read) == len(expected) == 4 + 2 + 4
    for theirs, ours in zip(read, expected, strict=True):
        assert (theirs.env, theirs.step) == (ours.env, ours.step)
        assert (theirs.indenter, theirs.depth_m) == (ours.indenter, ours.depth_m)
        assert np.abs(theirs.nodal_coordinates - ours.nodal_coordinates).max() <= stored
        for key in ("force", "pose", "sensor_pose"):
            np.testing.assert_array_equal(getattr(theirs, key), getattr(ours, key))
    assert layout == "biotac_sim" or {sample.trial for sample in read} == {2}


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
        if key in file:
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
        ("trial_0/step_0/nodal_coords_digit/env_0", [[b"a"] * 3] * 5, "nodal_coords_digit/env_0: could not convert"),
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


def test_several_trials_do_not_fit_into_a_file_of_biotac_sim(tmp_path):
    both = [Sample(trial, 0, 0, np.zeros((5, 3)), np.zeros(3)) for trial in (0, 1)]
    with pytest.raises(InputError, match="one per file"):
        write(tmp_path / "two.hdf5", "biotac_sim", "digit", both, {})
    assert not (tmp_path / "two.hdf5").exists()


@pytest.mark.parametrize("depth", [np.nan, [1e-3, 2e-3]])
def test_a_depth_that_is_none(tmp_path, depth):
    path = spoiled(tmp_path, "trial_0/step_0/max_contact_distances/env_0", depth)
    with ResultFile(path) as opened, pytest.raises(InputError, match="is not a depth in m"):
        opened.stated(0, 0, 0)


@pytest.mark.parametrize(
    "key, value", [("pose", np.eye(3)), ("sensor_pose", 1.0), ("indenter", 7), ("depth_m", "deep")]
)
def test_attributes_that_are_not_what_simgen_writes(tmp_path, key, value):
    path = spoiled(tmp_path, "trial_0/step_0/net_force_vecs_digit/env_0", np.zeros(3))
    with h5py.File(path, "a") as file:
        file["trial_0/step_0/nodal_coords_digit/env_0"].attrs[key] = value
    with ResultFile(path) as opened, pytest.raises(InputError) as raised:
        opened.stated(0, 0, 0)
    assert str(path) in str(raised.value) and "\n" not in str(raised.value)


def test_a_file_that_was_cut_short(tmp_path):
    samples = [Sample(0, 0, step, np.ones((5000, 3)), np.zeros(3)) for step in range(20)]
    write(tmp_path / "results.hdf5", "across", "digit", samples, {})
    whole = (tmp_path / "results.hdf5").read_bytes()
    for share in (0.1, 0.5, 0.99):
        (tmp_path / "results.hdf5").write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(InputError, match=r"results\.hdf5"), ResultFile(tmp_path / "results.hdf5") as opened:
            list(opened)
