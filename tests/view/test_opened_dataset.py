"""Datasets of all kinds open; those that cannot be read say why."""

import shutil

import numpy as np
import pytest

from simgen.errors import InputError
from simgen.view.opened_dataset import OpenedDataset


def test_a_dataset_is_opened_with_all_that_is_drawn(whole):
    opened = OpenedDataset(whole.path, None)
    assert opened.is_finished and opened.depths == 4 and len(opened.table) == 12
    assert opened.predictions is None
    for sensor in whole.sensors:
        moved = opened.surfaces[sensor].positions(3, 2) - opened.surfaces[sensor].surface.rest_mm
        truth = 1e3 * whole.displacement(sensor, 3, 2)[opened.surfaces[sensor].surface.vertices]
        np.testing.assert_allclose(moved, truth, atol=1e-5)
        assert opened.fields[sensor].pressed is opened.surfaces[sensor]
    assert [not opened.pictures[sensor].why_not for sensor in whole.sensors] == [True, False]  # no camera in a BioTac


def test_steps_of_a_path_count_as_depths(sliding):
    assert OpenedDataset(sliding.path, None).depths == 6


def test_an_imported_dataset_opens(imported):
    opened = OpenedDataset(imported.path, None)
    assert len(opened.table) == imported.presses and opened.is_finished


def test_an_unfinished_dataset_opens(unfinished, whole):
    opened = OpenedDataset(unfinished.path, None)
    assert not opened.is_finished
    shutil.copytree(whole.path, unfinished.path, dirs_exist_ok=True)
    assert not opened.is_finished  # since its table is that of before
    assert set(opened.table.status[:4]) == {"converged"} and set(opened.table.status[4:]) == {"not there yet"}


def test_what_is_no_dataset_is_refused(tmp_path):
    with pytest.raises(InputError, match="not a dataset"):
        OpenedDataset(tmp_path, None)
    with pytest.raises(InputError, match="nothing"):
        OpenedDataset(tmp_path / "nothing.zarr", None)


@pytest.mark.parametrize("gone", ["digit/rest_positions", "press/trajectory", "biotac/status"])
def test_an_array_that_is_missing_is_named(whole, tmp_path, gone):
    path = shutil.copytree(whole.path, tmp_path / "d.zarr")
    shutil.rmtree(path / gone)
    with pytest.raises(InputError, match=gone):
        OpenedDataset(path, None)


def test_networks_that_are_not_there_are_refused(whole, tmp_path):
    pytest.importorskip("torch", reason="torch is not installed (the training extra)")
    with pytest.raises(InputError, match="no folder of networks"):
        OpenedDataset(whole.path, tmp_path)
