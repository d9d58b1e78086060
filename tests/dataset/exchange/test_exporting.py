"""Exports: a folder that is whole or not there."""

import pytest

from simgen.dataset.exchange import exporting
from simgen.dataset.exchange.exporting import export
from simgen.errors import InputError


def test_by_default_the_first_trajectory_alone(dataset, tmp_path):
    selection, _ = export(dataset, "vtk", tmp_path / "out", ["digit"])
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"trajectory_0"}
    assert set(dataset["press/trajectory"][selection.presses]) == {0}


def test_the_files_that_were_written_are_returned(dataset, tmp_path):
    selection, files = export(dataset, "npy", tmp_path / "out", sensors=["biotac"], trajectories="1,3")
    assert selection.sensors == ("biotac",) and selection.presses.tolist() == [3, 4, 5, 9, 10, 11]
    assert sorted(files) == sorted(path for path in (tmp_path / "out").rglob("*") if path.is_file())
    assert {path.parts[-2] for path in files} == {"out", "sample", "biotac"}


def test_an_export_that_fails_leaves_nothing(dataset, tmp_path, monkeypatch):
    def half(selection, folder, track):
        (folder / "first").touch()
        raise RuntimeError("half way")

    monkeypatch.setitem(exporting.FORMATS, "npy", half)
    with pytest.raises(RuntimeError, match="half way"):
        export(dataset, "npy", tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_a_format_or_a_folder_that_will_not_do_is_one_line(dataset, tmp_path):
    with pytest.raises(InputError, match="--format 'hdf5': allowed: across, biotac_sim, npy, vtk"):
        export(dataset, "hdf5", tmp_path / "out")
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="exists already"):
        export(dataset, "npy", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
