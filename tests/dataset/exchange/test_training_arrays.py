"""Arrays for training: rows are aligned, equal to the dataset, and described by the index."""

import json

import numpy as np
import pytest

from simgen.dataset.exchange.exporting import export


@pytest.fixture(scope="module")
def folder(one_sided, tmp_path_factory):
    folder = tmp_path_factory.mktemp("npy") / "out"
    export(one_sided, "npy", folder)
    return folder


def mapped(folder, name):
    return np.load(folder / f"{name}.npy", mmap_mode="r")


def test_rows_are_the_samples_of_both_sensors(one_sided, folder):
    press, step = mapped(folder, "sample/press"), mapped(folder, "sample/step")
    paired = (one_sided["digit/status"] == 0) & (one_sided["biotac/status"] == 0)
    np.testing.assert_array_equal(np.stack([press, step], axis=1), np.argwhere(paired))
    for name in ("trajectory", "indenter", "split"):
        np.testing.assert_array_equal(mapped(folder, f"sample/{name}"), one_sided[f"press/{name}"][press])
    np.testing.assert_array_equal(mapped(folder, "sample/depth"), one_sided["depth"][step])
    for sensor in one_sided.sensors:
        for name in ("force", "moment"):
            expected = one_sided[f"{sensor}/{name}"][press, step]
            np.testing.assert_array_equal(mapped(folder, f"{sensor}/{name}"), expected)
        displacement = mapped(folder, f"{sensor}/displacement")
        assert isinstance(displacement, np.memmap) and displacement.dtype == np.float32
        for row in range(len(press)):
            expected = one_sided.displacement(sensor, int(press[row]), int(step[row]))
            np.testing.assert_array_equal(displacement[row], expected.astype(np.float32))
        for name in ("rest_positions", "tetrahedra", "surface_triangles", "held", "touchable"):
            np.testing.assert_array_equal(mapped(folder, f"{sensor}/{name}"), one_sided[f"{sensor}/{name}"])


def test_the_index_says_what_is_what(one_sided, folder):
    index = json.loads((folder / "index.json").read_text())
    files = {path.relative_to(folder).as_posix() for path in folder.rglob("*.npy")}
    assert index["arrays"].keys() == files
    for name, about in index["arrays"].items():
        array = np.load(folder / name, mmap_mode="r")
        assert (list(array.shape), array.dtype.name) == (about["shape"], about["dtype"])
        assert len(about["axes"].split(", ")) == array.ndim
    assert index["arrays"]["digit/displacement.npy"]["unit"] == "m"
    assert index["job_hash"] == one_sided.attributes["job_hash"] and index["job"] == one_sided.attributes["job"]
    assert index["splits"] == {"train": 0, "validation": 1, "test": 2, "none": -1}
    assert tuple(index["indenters"]) == one_sided.indenters
    assert index["samples"] == len(mapped(folder, "sample/press"))


def test_a_part_of_the_dataset(one_sided, tmp_path):
    """One sensor alone: the samples that the other one lacks are there."""
    export(one_sided, "npy", tmp_path / "out", ["biotac"], "2")
    assert set(mapped(tmp_path / "out", "sample/trajectory").tolist()) == {2}
    assert len(mapped(tmp_path / "out", "biotac/displacement")) == 3 * 4
    assert not (tmp_path / "out/digit").exists()
