"""Recordings of electrodes: arrays are read, and each bad file gives one line."""

import h5py
import numpy as np
import pytest

from simgen.errors import InputError
from simgen.sensing.electrodes.recordings import read_recordings

N, VERTICES = 6, 5
RANDOM = np.random.default_rng(0)
RECORDED = {
    "electrode_vals": RANDOM.normal(size=(N, 19)),
    "contact_loc": RANDOM.normal(size=(N, 3)),
    "force_vec": RANDOM.normal(size=(N, 3)),
    "indenter_type": np.arange(N)[:, None],
}
SIMULATED = {
    "nodal_res": RANDOM.normal(size=(N, VERTICES, 3)),
    "force_res": RANDOM.normal(size=(N, 3)),
    "mesh_max_dist": RANDOM.uniform(size=N),
}


def write(path, arrays, grouped):
    with h5py.File(path, "w") as file:
        for key, values in arrays.items():
            file[f"{key}/data" if grouped else key] = values
    return path


def check_recorded(found):
    np.testing.assert_array_equal(found.signals, RECORDED["electrode_vals"])
    np.testing.assert_array_equal(found.contact, RECORDED["contact_loc"])
    np.testing.assert_array_equal(found.force, RECORDED["force_vec"])
    assert len(found) == N


@pytest.mark.parametrize("grouped", [True, False])
def test_recordings_with_their_simulation_beside_them(tmp_path, grouped):
    found = read_recordings(
        write(tmp_path / "real.hdf5", RECORDED, grouped), write(tmp_path / "sim.hdf5", SIMULATED, not grouped)
    )
    check_recorded(found)
    np.testing.assert_array_equal(found.indenter, np.arange(N))
    assert found.indenter.dtype == np.int64
    np.testing.assert_array_equal(found.simulated_mesh, SIMULATED["nodal_res"])
    np.testing.assert_array_equal(found.simulated_force, SIMULATED["force_res"])
    np.testing.assert_array_equal(found.simulated_depth, SIMULATED["mesh_max_dist"])


def test_what_may_be_missing(tmp_path):
    alone = {key: values for key, values in RECORDED.items() if key != "indenter_type"}
    found = read_recordings(write(tmp_path / "real.hdf5", alone, True))
    check_recorded(found)
    nothing = (found.indenter, found.simulated_mesh, found.simulated_force, found.simulated_depth)
    assert nothing == (None, None, None, None)


def test_all_in_one_file_in_either_shape(tmp_path):
    arrays = RECORDED | SIMULATED | {"indenter_type": np.full(N, 3.0), "mesh_max_dist": np.ones((N, 1))}
    found = read_recordings(write(tmp_path / "both.hdf5", arrays, True))
    np.testing.assert_array_equal(found.indenter, np.full(N, 3))
    np.testing.assert_array_equal(found.simulated_depth, np.ones(N))


@pytest.mark.parametrize(
    "key, values, complaint",
    [
        ("electrode_vals", None, "electrode_vals: not there"),
        ("electrode_vals", np.zeros((N, 18)), "shape (6, 18); allowed: (n, 19)"),
        ("electrode_vals", np.zeros((0, 19)), "shape (0, 19); allowed: (n, 19)"),
        ("electrode_vals", np.float64(3), "shape (); allowed: (n, 19)"),
        ("electrode_vals", np.full((N, 19), np.nan), "electrode_vals/data: values that are not finite numbers"),
        ("electrode_vals", [[b"a"] * 19] * N, "electrode_vals/data: could not convert"),
        ("contact_loc", None, "contact_loc: not there"),
        ("contact_loc", np.zeros((N + 1, 3)), "contact_loc/data: shape (7, 3); allowed: (6, 3)"),
        ("force_vec", None, "force_vec: not there"),
        ("force_vec", np.zeros((N, 3, 1)), "shape (6, 3, 1); allowed: (6, 3)"),
        ("force_vec", np.full((N, 3), np.inf), "force_vec/data: values that are not finite"),
        ("indenter_type", np.zeros((N, 2)), "shape (6, 2); allowed: (6,)"),
        ("indenter_type", np.full(N, 0.5), "indenter_type: 0.5; allowed: whole numbers"),
        ("indenter_type", np.full(N, 1e300), "indenter_type: 1e+300; allowed: whole numbers"),
        ("nodal_res", np.zeros((N, 0, 3)), "shape (6, 0, 3); allowed: (6, vertex, 3)"),
        ("nodal_res", np.zeros((N, 3)), "shape (6, 3); allowed: (6, vertex, 3)"),
        ("nodal_res", np.zeros((N - 1, VERTICES, 3)), "shape (5, 5, 3); allowed: (6, vertex, 3)"),
        ("force_res", np.zeros(N), "force_res/data: shape (6,); allowed: (6, 3)"),
        ("mesh_max_dist", np.full(N, np.nan), "mesh_max_dist/data: values that are not finite"),
    ],
)
def test_bad_files_are_one_clear_line(tmp_path, key, values, complaint):
    arrays = RECORDED | SIMULATED | {key: values}
    arrays = {name: each for name, each in arrays.items() if each is not None}
    path = write(tmp_path / "bad.hdf5", arrays, True)
    with pytest.raises(InputError) as raised:
        read_recordings(path)
    assert complaint in str(raised.value)
    assert str(path) in str(raised.value) and "\n" not in str(raised.value)


def test_a_simulation_that_is_asked_for_has_meshes(tmp_path):
    real = write(tmp_path / "real.hdf5", RECORDED, True)
    with pytest.raises(InputError, match="nodal_res: not there"):
        read_recordings(real, real)


def test_what_is_no_recording(tmp_path):
    text, empty, group = tmp_path / "text.hdf5", tmp_path / "empty.hdf5", tmp_path / "group.hdf5"
    text.write_text("no HDF5")
    empty.touch()
    with h5py.File(group, "w") as file:
        file.create_group("electrode_vals")
    for path, complaint in (
        (text, "cannot be read as HDF5"),
        (empty, "cannot be read as HDF5"),
        (tmp_path, "cannot be read as HDF5"),
        (tmp_path / "nowhere.hdf5", "cannot be read as HDF5"),
        (group, "electrode_vals/data: not there"),
    ):
        with pytest.raises(InputError) as raised:
            read_recordings(path)
        assert complaint in str(raised.value) and str(path) in str(raised.value)


def test_a_file_that_announces_more_than_memory_holds(tmp_path):
    path = write(tmp_path / "huge.hdf5", RECORDED, True)
    with h5py.File(path, "a") as file:
        del file["electrode_vals/data"]
        file.create_dataset("electrode_vals/data", shape=(10**12, 19), chunks=(1, 19), dtype="f8")
    with pytest.raises(InputError, match="more memory"):
        read_recordings(path)
