"""The catalogue of result files: trials, indenters, and files that do not belong together."""

import h5py
import pytest

from dataset.exchange.foreign_files import of_others, spoiled
from simgen.dataset.exchange.catalogue import read_catalogue
from simgen.dataset.exchange.importing import import_results
from simgen.dataset.exchange.selection import untracked
from simgen.errors import InputError
from simgen.sensors.indenter import indenter_names


def read(files, mesh, sensors=("digit",)):
    return read_catalogue(files, dict.fromkeys(sensors, mesh), untracked)


def test_samples_are_listed_by_trial_and_published_indenter(tetrahedron, tmp_path):
    mesh, rest = tetrahedron
    samples = [(trial, env, step, rest, 1e-4 * step) for trial in (4, 2) for env in (1, 0) for step in range(3)]
    found = read([of_others(tmp_path / "results_digit_x.hdf5", "across", samples)], mesh)
    names = indenter_names()[:2]
    assert found.trials == [2, 4] and found.names == list(names) and not found.indenters_stated
    assert set(found.samples["digit"]) == {(trial, name) for trial in (2, 4) for name in names}
    assert [place.step for place in found.samples["digit"][4, names[1]]] == [0, 1, 2]
    assert sorted(found.depths()) == sorted(1e-4 * step for _, _, step, _, _ in samples)
    assert found.first_touch == {"digit": {}}  # the files do not say where their sensor lies


def test_files_of_biotac_sim_are_trajectories_in_their_order(tetrahedron, tmp_path):
    mesh, rest = tetrahedron
    files = [of_others(tmp_path / f"{name}.hdf5", "biotac_sim", [spoiled(rest, depth=None)]) for name in "abc"]
    with h5py.File(files[2], "a") as file:
        file.attrs["trial"] = 7
    assert read(files, mesh).trials == [0, 1, 7]


@pytest.mark.parametrize("text", ["[4, 2]", "[0]", "4", "[", '["4"]'])
def test_a_growth_that_simgen_did_not_write_is_one_line(tetrahedron, tmp_path, text):
    mesh, rest = tetrahedron
    file = of_others(tmp_path / "results_digit_x.hdf5", "across", [spoiled(rest)])
    with h5py.File(file, "a") as opened:
        opened.attrs.update({"job": "{}", "grown_from": text})
    with pytest.raises(InputError, match="attribute grown_from: not what simgen wrote"):
        read([file], mesh)


def test_files_that_do_not_belong_together(tetrahedron, tmp_path):
    mesh, rest = tetrahedron
    one, other = (of_others(tmp_path / f"results_digit_{name}.hdf5", "across", [spoiled(rest)]) for name in "ab")
    output = tmp_path / "x.zarr"
    with pytest.raises(InputError, match="trajectory 0 of digit is in another file, too; import one job at a time"):
        import_results([one, other], [f"digit={mesh}"], output)
    for file, job in ((one, "{}"), (other, "[]")):
        with h5py.File(file, "a") as opened:
            opened.attrs["job"] = job
    with pytest.raises(InputError, match="its job differs from that of"):
        import_results([one, other], [f"digit={mesh}"], output)
    with h5py.File(one, "a") as opened:
        opened.attrs["job"] = "{"
    with pytest.raises(InputError, match="attribute job: not what simgen wrote"):
        import_results([one], [f"digit={mesh}"], output)
    nameless = of_others(tmp_path / "results.hdf5", "biotac_sim", [spoiled(rest)])
    with h5py.File(nameless, "a") as opened:
        opened.attrs["trial"] = "first"
    with pytest.raises(InputError, match="attribute trial: 'first' is not the number of a trajectory"):
        import_results([nameless], [f"digit={mesh}"], output)
    with pytest.raises(InputError, match="does not name its sensor; import it with one --mesh alone"):
        import_results([nameless], [f"digit={mesh}", f"biotac={mesh}"], output)
    assert not output.exists()
