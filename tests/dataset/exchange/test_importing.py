"""Result files as datasets: round trips, files of others, and what the audit says of them."""

import hashlib
from dataclasses import replace

import fake
import h5py
import numpy as np
import pytest

from dataset.exchange.conftest import make_dataset
from dataset.exchange.foreign_files import of_others, spoiled
from simgen.dataset.audit import check, passes, to_repair
from simgen.dataset.exchange import ResultFile, write
from simgen.dataset.exchange.exporting import export
from simgen.dataset.exchange.importing import ABSENT, import_results
from simgen.dataset.reader import Dataset
from simgen.dataset.splits import IN_NONE
from simgen.errors import InputError
from simgen.pipeline.run_status import run_status
from simgen.sensors.indenter import indenter_names


def import_all(folder, output, suffix="vtu", **options):
    meshes = [f"{sensor}={folder}/rest_{sensor}.{suffix}" for sensor in ("digit", "biotac")]
    return import_results(sorted(folder.glob("*.hdf5")), meshes, output, **options)


def storage_error(dataset, sensor):
    """Of displacements, m: coordinates and displacements are rounded to float32, each by half a unit in the last place.

    Subtracting the rest positions is in float64, whose rounding (1e-18 m) is less than a thousandth of that.
    """
    rest = dataset[f"{sensor}/rest_positions"]
    farthest = np.abs(rest).max() + 1e-3  # no vertex of the stand-in moves farther
    return 1.001 * 0.5 * (np.spacing(np.float32(farthest)) + np.spacing(np.float32(1e-3)))


@pytest.mark.parametrize("layout", ["across", "biotac_sim"])
@pytest.mark.parametrize("which", ["dataset", "one_sided"])
def test_round_trip(which, layout, request, tmp_path):
    dataset = request.getfixturevalue(which)
    export(dataset, layout, tmp_path / "out")
    imported = import_all(tmp_path / "out", tmp_path / "back.zarr")
    assert imported.imported and not dataset.imported
    assert (imported.sensors, imported.indenters) == (dataset.sensors, dataset.indenters)
    for name in ("depth", "press/trajectory", "press/indenter", "press/split"):
        np.testing.assert_array_equal(imported[name], dataset[name])
    for sensor in dataset.sensors:
        there = dataset[f"{sensor}/status"] == 0
        np.testing.assert_array_equal(imported[f"{sensor}/status"], np.where(there, 0, ABSENT))
        np.testing.assert_array_equal(imported[f"{sensor}/force"], dataset[f"{sensor}/force"])  # NaN where not there
        for name in ("rest_positions", "tetrahedra", "held", "touchable"):
            np.testing.assert_array_equal(imported[f"{sensor}/{name}"], dataset[f"{sensor}/{name}"])
        for press in range(dataset.presses):
            ours, theirs = (each.displacement(sensor, press) for each in (dataset, imported))
            assert np.abs(theirs - ours)[there[press]].max(initial=0.0) <= storage_error(dataset, sensor)
            assert np.isnan(theirs[~there[press]]).all()
        stated = np.where(there, dataset["depth"], np.nan)
        np.testing.assert_array_equal(imported[f"{sensor}/stated_depth"], stated)


def test_a_path_comes_back_step_by_step(tmp_path):
    """Three steps at one depth, which depths alone could not tell apart."""
    legs = [{"move_mm": [0.2, 0.0, 0.0], "steps": 2}, {"move_mm": [0.0, -0.3, 0.0], "turn_deg": 9.0, "steps": 1}]
    dataset = make_dataset(tmp_path / "d.zarr", fake.fake_presser, trajectories={"count": 2, "path": legs})
    export(dataset, "across", tmp_path / "out")
    imported = import_all(tmp_path / "out", tmp_path / "back.zarr")
    for name in ("depth", "path/offset", "path/turn", "path/leg", "digit/status", "biotac/force"):
        np.testing.assert_array_equal(imported[name], dataset[name])
    moved = imported.displacement("digit", 1) - dataset.displacement("digit", 1)
    assert np.abs(moved).max() <= storage_error(dataset, "digit")
    np.testing.assert_allclose(imported["press/pose"], dataset["press/pose"], atol=1e-15)
    assert passes(check(imported))
    with pytest.raises(InputError, match="--depths-mm: the files' job has legs"):
        import_all(tmp_path / "out", tmp_path / "again.zarr", depths_mm="0.1:0.4:4")


def test_a_dataset_that_has_grown_keeps_its_splits(tmp_path):
    make_dataset(tmp_path / "d.zarr", fake.fake_presser, trajectories={"count": 4})
    dataset = make_dataset(tmp_path / "d.zarr", fake.fake_presser, trajectories={"count": 20})
    assert dataset.grown_from == (4,)
    export(dataset, "across", tmp_path / "out")
    imported = import_all(tmp_path / "out", tmp_path / "back.zarr")
    np.testing.assert_array_equal(imported["press/split"], dataset["press/split"])
    at_once = make_dataset(tmp_path / "e.zarr", fake.fake_presser, trajectories={"count": 20})
    assert (at_once["press/split"] != dataset["press/split"]).any()  # so that the job alone would not do


def test_poses_come_back_as_far_as_samples_tell_them(one_sided, tmp_path):
    """To the rounding of a few float64 products. The ring's sensor poses are known where the ring has samples."""
    export(one_sided, "across", tmp_path / "out")
    imported, ring = import_all(tmp_path / "out", tmp_path / "back.zarr"), one_sided["press/indenter"] == 1
    both = ~ring
    np.testing.assert_allclose(imported["press/pose"][both], one_sided["press/pose"][both], atol=1e-15)
    for sensor in one_sided.sensors:
        np.testing.assert_array_equal(imported[f"{sensor}/pose"][both], one_sided[f"{sensor}/pose"][both])
        np.testing.assert_allclose(imported[f"{sensor}/touch"][both], one_sided[f"{sensor}/touch"][both], atol=1e-15)
    # Where the first sensor is not touched, travel begins where the second one is: the same place in the shared frame.
    assert np.isnan(imported["digit/touch"][ring]).all() and np.isnan(imported["digit/pose"][ring]).all()
    moved = one_sided["press/pose"][ring][:, :3, 1] * one_sided["biotac/touch"][ring][:, None]
    np.testing.assert_allclose(
        imported["press/pose"][ring][:, :3, 3], one_sided["press/pose"][ring][:, :3, 3] + moved, atol=1e-15
    )
    np.testing.assert_array_equal(imported["biotac/touch"][ring], 0.0)


def test_what_is_imported_can_be_exported_again(dataset, tmp_path):
    export(dataset, "across", tmp_path / "out", trajectories="1:3")
    imported = import_all(tmp_path / "out", tmp_path / "back.zarr")
    assert set(imported["press/trajectory"]) == {1, 2}
    for name in ("across", "npy", "vtk"):
        export(imported, name, tmp_path / name)
    with (
        h5py.File(tmp_path / "out/results_digit_fake.hdf5") as first,
        h5py.File(tmp_path / "across/results_digit_fake.hdf5") as second,
    ):
        key = "trial_2/step_3/nodal_coords_digit/env_0"
        assert np.abs(first[key][:] - second[key][:]).max() <= storage_error(dataset, "digit")


@pytest.mark.parametrize("trajectories", [None, "1:9"])
def test_an_indenter_that_was_left_out_stays_out(tmp_path, trajectories):
    """And a part of a dataset keeps the splits of the whole."""
    changes = {"trajectories": {"count": 12}, "dataset": {"leave_out": "ring_7mm"}}
    dataset = make_dataset(tmp_path / "fake.zarr", fake.fake_presser, **changes)
    export(dataset, "across", tmp_path / "out", trajectories=trajectories)
    imported = import_all(tmp_path / "out", tmp_path / "back.zarr")
    same = np.isin(dataset["press/trajectory"], imported["press/trajectory"])
    assert (dataset["press/split"] == IN_NONE).any()
    np.testing.assert_array_equal(imported["press/split"], dataset["press/split"][same])


def test_the_source_is_on_record(dataset, tmp_path):
    export(dataset, "across", tmp_path / "out")
    source = import_all(tmp_path / "out", tmp_path / "back.zarr", suffix="tet").attributes["source"]
    sums = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in (tmp_path / "out").iterdir()}
    assert {file["name"]: file["sha256"] for file in source["files"]} == {
        name: total for name, total in sums.items() if name.endswith("hdf5")}  # fmt: skip
    assert {mesh["name"]: mesh["sha256"] for mesh in source["meshes"].values()} == {
        name: total for name, total in sums.items() if name.endswith("tet")}  # fmt: skip
    assert source["job"] == dataset.attributes["job"]


@pytest.mark.parametrize("suffix", ["vtu", "tet"])
def test_the_audit_says_what_does_not_apply(dataset, tmp_path, suffix):
    export(dataset, "across", tmp_path / "out")
    imported = import_all(tmp_path / "out", tmp_path / "back.zarr", suffix=suffix)
    findings = check(imported)
    assert passes(findings)
    for sensor in imported.sensors:
        unknown = {each.what for each in findings if each.subject == sensor and each.found == "not looked at"}
        expected = {"certificates", "on the indenter", "contacts"}
        assert unknown == (expected if suffix == "vtu" else expected | {"held vertices move"})
    samples = next(each for each in findings if each.what == "samples in the files")
    assert samples.found == "40 of 48" and "In none of the files" in samples.note
    assert run_status(imported).finished == imported.presses
    assert to_repair(imported, findings) == []


def test_damage_is_found_and_not_repaired(dataset, tmp_path):
    export(dataset, "across", tmp_path / "out")
    imported = import_all(tmp_path / "out", tmp_path / "back.zarr")
    (imported.path / sorted(imported.shard_files(1))[0]).write_bytes(b"rotten")
    findings = check(imported)
    assert not passes(findings)
    with pytest.raises(InputError, match="cannot be solved again; import it anew"):
        to_repair(imported, findings)


def test_files_of_others_go_by_step_and_published_order(tetrahedron, tmp_path):
    mesh, rest = tetrahedron
    files = [
        of_others(tmp_path / f"{name}.hdf5", "biotac_sim", [(0, env, step, rest + 1e-4 * step, None)
                                                           for env in (3, 0) for step in range(3)])
        for name in ("a", "b")
    ]  # fmt: skip
    imported = import_results(files, [f"biotac={mesh}"], tmp_path / "others.zarr", depths_mm="0.1:0.4:4")
    published = indenter_names()
    assert imported.indenters == (published[0], published[3])
    assert imported.job.name == "others" and imported.job.trajectories.count == 2
    assert imported.attributes["source"]["indenters"] == "the published order of environments"
    np.testing.assert_array_equal(imported["biotac/status"], np.tile([0, 0, 0, ABSENT], (4, 1)))
    assert np.isnan(imported["biotac/pose"]).all() and np.isnan(imported["press/pose"]).all()
    assert np.isnan(imported["biotac/stated_depth"]).all()
    # rest + 0.2 mm - rest, of numbers up to 1 cm in float64, then in float32
    moved, rounding = imported.displacement("biotac", 3, 2), np.spacing(1e-2) + 0.5 * np.spacing(np.float32(2e-4))
    np.testing.assert_allclose(moved, 2e-4, rtol=0, atol=rounding)
    np.testing.assert_array_equal(imported["biotac/force"][1, 2], [0.0, 3.0, 0.0])
    assert imported.get("biotac/held") is None and imported.get("press/contact_pose") is None
    assert passes(check(imported))


def test_a_sensor_elsewhere_in_its_world(dataset, tetrahedron, tmp_path):
    """Files of others, and one of simgen's that somebody has moved: the poses still fit together."""
    mesh, rest = tetrahedron
    file = of_others(tmp_path / "a.hdf5", "biotac_sim", [(0, 0, 0, rest + np.array([1e-4, 0.05, 0.0]), None)])
    options = {"depths_mm": "0.1:0.1:1", "origins_mm": ["biotac=0,50,0"]}
    imported = import_results([file], [f"biotac={mesh}"], tmp_path / "a.zarr", **options)
    # in float64 at 6 cm, then in float32
    rounding = 2 * np.spacing(0.06) + 0.5 * np.spacing(np.float32(1e-4))
    moved = imported.displacement("biotac", 0, 0)
    np.testing.assert_allclose(moved, np.broadcast_to([1e-4, 0.0, 0.0], moved.shape), rtol=0, atol=rounding)

    export(dataset, "across", tmp_path / "out", ["digit"], "2")
    away = np.eye(4)
    away[:3, 3] = [0.01, 0.0, -0.02]
    path = tmp_path / "out/results_digit_fake.hdf5"
    with ResultFile(path) as opened:
        samples, attributes = list(opened), opened.attributes
    moved = [
        replace(each, nodal_coordinates=each.nodal_coordinates + away[:3, 3], pose=away @ each.pose,
                sensor_pose=each.sensor_pose @ np.linalg.inv(away))
        for each in samples
    ]  # fmt: skip
    write(path, "across", "digit", moved, attributes)
    mesh = f"digit={tmp_path}/out/rest_digit.vtu"
    imported = import_results([path], [mesh], tmp_path / "b.zarr", origins_mm=["digit=10,0,-20"])
    of_trajectory = dataset["press/trajectory"] == 2
    for name in ("press/pose", "digit/pose"):
        np.testing.assert_allclose(imported[name], dataset[name][of_trajectory], atol=1e-15)
    assert passes(check(imported))  # what is held has not moved


@pytest.mark.parametrize(
    "changes, options, complaint",
    [
        ({"coordinates": np.zeros((5, 3))}, {}, "5 vertices, but the mesh of digit has 4"),
        ({"coordinates": np.full((4, 3), np.nan)}, {}, "values that are not finite numbers"),
        ({"coordinates": np.full((4, 3), 0.05)}, {}, "mm from the mesh of digit, at most 10 is allowed"),
        ({"env": 9}, {}, "env_9: names no indenter, and the published order ends with env_8"),
        ({"depth": None}, {}, "do not say how deep their steps are; add --depths-mm first:last:count"),
        ({"depth": None, "step": 3}, {"depths_mm": "0.1:0.3:3"}, "step_3, but there are 3 depths"),
        ({"depth": 0.02}, {}, "depths_mm.first: 20.0 is not allowed"),
        ({}, {"depths_mm": "0.1:0.3"}, "--depths-mm '0.1:0.3': write it as first:last:count"),
        ({}, {"depths_mm": "0.3:0.1:3"}, "first must be less than last"),
        ({}, {"depths_mm": "0.1:0.3:3"}, "no sample is at depths of 0.1 to 0.3 mm"),
        ({}, {"origins_mm": ["digit=0,50"]}, "--origin-mm digit=0,50: write it as SENSOR=X,Y,Z"),
        ({}, {"origins_mm": ["digit=0,50,up"]}, "--origin-mm digit=0,50,up: write it as SENSOR=X,Y,Z"),
        ({}, {"origins_mm": ["biotac=0,50,0"]}, "--origin-mm biotac=0,50,0: sensor 'biotac' has no --mesh"),
        ({}, {"name": "7"}, "--name: name: \"7\" is not allowed"),
    ],
)  # fmt: skip
def test_bad_samples_and_options_are_one_line(tetrahedron, tmp_path, changes, options, complaint):
    mesh, rest = tetrahedron
    file = of_others(tmp_path / "results_digit_x.hdf5", "across", [spoiled(rest, **changes)])
    with pytest.raises(InputError) as raised:
        import_results([file], [f"digit={mesh}"], tmp_path / "x.zarr", **options)
    assert complaint in str(raised.value) and "\n" not in str(raised.value)
    assert {path.name for path in tmp_path.iterdir()} == {"cell.tet", file.name}  # nothing is left


def linked(file, key, other, link):
    """Move what a file has at a key into another file, and lead there by ``link``."""
    with h5py.File(file, "a") as opened, h5py.File(other, "w") as moved:
        opened.copy(key, moved, "moved")
        values = moved["moved"][()] if isinstance(moved["moved"], h5py.Dataset) else None
        del opened[key]
        if link == "external":
            opened[key] = h5py.ExternalLink(other.name, "moved")
        elif link == "soft to external":
            opened["aside"] = h5py.ExternalLink(other.name, "/")
            opened[key] = h5py.SoftLink("/aside/moved")
        elif link == "storage":
            other.with_suffix(".raw").write_bytes(values.tobytes())
            raw = [(other.with_suffix(".raw").name, 0, values.nbytes)]
            opened.create_dataset(key, values.shape, values.dtype, external=raw)
        else:
            layout = h5py.VirtualLayout(values.shape, values.dtype)
            layout[...] = h5py.VirtualSource(other.name, "moved", values.shape)
            opened.create_virtual_dataset(key, layout)


@pytest.mark.parametrize(("key", "link"), [
    ("trial_0", "external"),
    ("trial_0/step_0", "external"),
    ("trial_0/step_0/nodal_coords_digit/env_0", "external"),
    ("trial_0/step_0/max_contact_distances", "external"),
    ("trial_0/step_0/net_force_vecs_digit/env_0", "external"),
    ("trial_0/step_0", "soft to external"),
    ("trial_0/step_0/nodal_coords_digit/env_0", "storage"),
    ("trial_0/step_0/nodal_coords_digit/env_0", "virtual"),
])  # fmt: skip
def test_what_lies_in_another_file_is_refused(tetrahedron, tmp_path, monkeypatch, key, link):
    """A file that somebody sends may lead to any other file of the machine on which it is read."""
    mesh, rest = tetrahedron
    monkeypatch.chdir(tmp_path)  # where HDF5 looks for external storage
    file = of_others(tmp_path / "results_digit_x.hdf5", "across", [spoiled(rest)])
    linked(file, key, tmp_path / "private.h5", link)
    with pytest.raises(InputError, match=f"results_digit_x.hdf5: {key}.*: lies in another file, .*private") as raised:
        import_results([file], [f"digit={mesh}"], tmp_path / "x.zarr")
    assert "\n" not in str(raised.value) and not (tmp_path / "x.zarr").exists()


def test_links_within_a_file_are_followed(tetrahedron, tmp_path):
    mesh, rest = tetrahedron
    file = of_others(tmp_path / "results_digit_x.hdf5", "across", [spoiled(rest + 1e-4)])
    with h5py.File(file, "a") as opened:
        opened.move("trial_0/step_0", "aside")
        opened["trial_0/step_0"] = h5py.SoftLink("/aside")
    imported = import_results([file], [f"digit={mesh}"], tmp_path / "x.zarr")
    np.testing.assert_allclose(imported.displacement("digit", 0, 0), np.full((4, 3), 1e-4), rtol=1e-6)


def test_a_dataset_that_is_there_stays(dataset, tmp_path):
    export(dataset, "across", tmp_path / "out")
    before = import_all(tmp_path / "out", tmp_path / "back.zarr").attributes
    with pytest.raises(InputError, match="exists already"):
        import_all(tmp_path / "out", tmp_path / "back.zarr")
    assert Dataset(tmp_path / "back.zarr").attributes == before
