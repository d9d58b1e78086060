"""Export to the layouts of ACROSS and biotac_sim, read as the published loaders read them."""

import h5py
import meshio
import numpy as np
import pytest

from simgen.dataset.exchange.across import PAIRS
from simgen.dataset.exchange.exporting import export


class PublishedReader:
    """Reads by the rules of ACROSS's loader (Mesh_Reconstruction, mesh_data_loader.py), and by nothing else.

    One table without pickled objects; a row unpacks into seven values, each of which goes into a name or through
    ``int`` or ``float`` as it is; the step's column depends on the sensor; arrays are read with ``[:]``.
    """

    def __init__(self, folder):
        self.folder, self.table = folder, np.load(folder / "filtered_dataset_pairs.npy", allow_pickle=False)

    def __len__(self):
        return len(self.table)

    def read(self, row, sensor):
        _job, job_name, trial, env, distance, digit_step, biotac_step = self.table[row]
        step = {"digit": digit_step, "biotac": biotac_step}[sensor]
        with h5py.File(f"{self.folder}/results_{sensor}_{job_name}.hdf5", "r") as file:
            of_step = file[f"trial_{trial}"][f"step_{step}"]
            nodes = of_step[f"nodal_coords_{sensor}"][f"env_{env}"][:]
            force = of_step[f"net_force_vecs_{sensor}"][f"env_{env}"][:]
        return np.float32(nodes), np.float32(force), float(distance), int(env), int(trial), int(step)


def published_mesh(path):
    """As ACROSS reads a .tet: words divided by one space, vertices of three numbers, cells of all that follow."""
    rows = [line.split(" ") for line in path.read_text().split("\n")]
    vertices = [[float(word) for word in row[1:4]] for row in rows if row[0] == "v"]
    return np.array(vertices), np.array([[int(word) for word in row[1:]] for row in rows if row[0] == "t"])


def press_of(dataset, trial, env):
    return int(np.flatnonzero((dataset["press/trajectory"] == trial) & (dataset["press/indenter"] == env))[0])


@pytest.mark.parametrize("which", ["dataset", "one_sided"])
def test_the_published_reader_finds_every_pair(which, request, tmp_path):
    dataset = request.getfixturevalue(which)
    export(dataset, "across", tmp_path / "out")
    reader = PublishedReader(tmp_path / "out")
    paired = (dataset["digit/status"] == 0) & (dataset["biotac/status"] == 0)
    assert len(reader) == np.count_nonzero(paired) < paired.size
    found = set()
    for row in range(len(reader)):
        for sensor in ("digit", "biotac"):
            nodes, force, distance, env, trial, step = reader.read(row, sensor)
            press = press_of(dataset, trial, env)
            expected = dataset[f"{sensor}/rest_positions"] + dataset.displacement(sensor, press, step)
            np.testing.assert_array_equal(nodes, expected.astype(np.float32))
            np.testing.assert_array_equal(force, dataset[f"{sensor}/force"][press, step].astype(np.float32))
            assert distance == dataset["depth"][step]
        found.add((press, step))
    assert found == set(map(tuple, np.argwhere(paired).tolist()))  # each once


def test_the_table_is_text_and_shuffled_always_alike(dataset, tmp_path):
    for name in ("a", "b"):
        export(dataset, "across", tmp_path / name)
    table = np.load(tmp_path / "a" / PAIRS)
    assert table.dtype.kind == "U" and table.shape == (40, 7)
    assert (tmp_path / "a" / PAIRS).read_bytes() == (tmp_path / "b" / PAIRS).read_bytes()
    numbers = table[:, [2, 3, 5]].astype(int).tolist()
    assert numbers != sorted(numbers)  # the published loader splits by the row's number
    assert set(table[:, 0]) == {"0"} and set(table[:, 1]) == {"fake"}


def test_a_file_has_every_sample_of_its_sensor_and_no_other(one_sided, tmp_path):
    """Pairs lack the ring, which never touches the first sensor; the second sensor's file has it."""
    export(one_sided, "across", tmp_path / "out")
    for sensor in ("digit", "biotac"):
        with h5py.File(tmp_path / "out" / f"results_{sensor}_fake.hdf5") as file:
            names = []
            file.visit(names.append)
            names = {name for name in names if isinstance(file[name], h5py.Dataset)}
        expected = {
            f"trial_{one_sided['press/trajectory'][press]}/step_{step}/{feature}/env_{one_sided['press/indenter'][press]}"
            for press, step in np.argwhere(one_sided[f"{sensor}/status"] == 0)
            for feature in (f"nodal_coords_{sensor}", f"net_force_vecs_{sensor}", "max_contact_distances")
        }
        assert names == expected


def test_biotac_sim_has_a_file_for_each_trajectory(dataset, tmp_path):
    _, files = export(dataset, "biotac_sim", tmp_path / "out", ["digit"], "1,3")
    assert [path.name for path in files if path.suffix == ".hdf5"] == [
        "results_digit_fake_trial_1.hdf5", "results_digit_fake_trial_3.hdf5"]  # fmt: skip
    press = press_of(dataset, 3, 2)
    with h5py.File(tmp_path / "out/results_digit_fake_trial_3.hdf5") as file:
        for step in range(4):
            expected = dataset["digit/rest_positions"] + dataset.displacement("digit", press, step)
            np.testing.assert_array_equal(file[f"step_{step}/nodal_coords/env_2"][:], expected.astype(np.float32))
            force = file[f"step_{step}/net_force_vecs/env_2"][:]
            np.testing.assert_array_equal(force, dataset["digit/force"][press, step])
        assert "env_1" not in file["step_2/nodal_coords"]  # the ring did not get there


@pytest.mark.parametrize("layout", ["across", "biotac_sim"])
def test_rest_meshes_lie_beside(dataset, layout, tmp_path):
    export(dataset, layout, tmp_path / "out", trajectories="0")
    for sensor in dataset.sensors:
        mesh = meshio.read(tmp_path / "out" / f"rest_{sensor}.vtu")
        vertices, tetrahedra = published_mesh(tmp_path / "out" / f"rest_{sensor}.tet")
        for points, cells in ((mesh.points, mesh.cells_dict["tetra"]), (vertices, tetrahedra)):
            np.testing.assert_array_equal(points, dataset[f"{sensor}/rest_positions"])
            np.testing.assert_array_equal(cells, dataset[f"{sensor}/tetrahedra"])
        for flag in ("held", "touchable"):
            np.testing.assert_array_equal(mesh.point_data[flag] > 0, dataset[f"{sensor}/{flag}"])


def test_one_sensor_has_no_pairs(dataset, tmp_path):
    _, files = export(dataset, "across", tmp_path / "out", ["biotac"])
    assert {path.name for path in files} == {"results_biotac_fake.hdf5", "rest_biotac.vtu", "rest_biotac.tet"}
