"""`simgen translate`: one good call each way, and one line for bad input."""

import json
import shutil
from pathlib import Path

import fake
import h5py
import numpy as np
import pytest
from PIL import Image
from refusal import check_refusal, contents, rows, simgen

from simgen.cli import translate as view
from simgen.dataset.reader import Dataset
from simgen.learning.translation.accuracy import Accuracy, read_contact
from simgen.pipeline.run import run
from simgen.sensing.camera.image_files import read_image
from tests.learning import touched

SMALL = "--size 48x64"
TRANSLATE = "translate networks d.zarr"
RECORDED = f"{TRANSLATE} --recordings a.h5"
BAD = [
    ("no networks", "translate gone d.zarr", "gone: no folder of networks; allowed: one that `simgen train` wrote"),
    ("a dataset for networks", "translate d.zarr d.zarr", "d.zarr: no folder of networks; allowed: one that `simgen"),
    ("a network for networks", "translate networks/rmd d.zarr", "networks/rmd: no folder of networks; allowed: one"),
    ("no dataset", "translate networks gone.zarr", "gone.zarr: not a dataset"),
    ("networks for a dataset", "translate networks networks", "networks: not a dataset"),
    ("unknown way", f"{TRANSLATE} --way theirs", "--way 'theirs': allowed: points, ours, paper"),
    ("a way that is not trained", "translate ours d.zarr --way paper",
     "ours: not all networks of a way are trained: paper"),
    ("neither way", "translate none d.zarr",
     "ours lacks s2rm, rmb, rm2rm, rmd; paper lacks svb, s2mpn, mvb, m2mpn, mvd"),
    ("samples of a dataset", f"{TRANSLATE} --samples 0:10",
     "--samples 0:10: needs --recordings; allowed for a dataset: "),
    ("samples no range", f"{RECORDED} --samples some", "--samples 'some': write it as 0:200 (the end"),
    ("samples one number", f"{RECORDED} --samples 7", "--samples '7': write it as 0:200 (the end ex"),
    ("samples none", f"{RECORDED} --samples 7:7", "--samples '7:7': write it as 0:200 (the end ex"),
    ("samples without contact", f"{RECORDED} --samples 4:5", "a.h5: --samples 4:5: none of them is"),
    ("trajectories of a recording", f"{RECORDED} --trajectories 0", "--trajectories 0: applies to a dataset; "),
    ("split of a recording", f"{RECORDED} --split test", "--split test: applies to a dataset; allowed with --rec"),
    ("workers of a recording", f"{RECORDED} --workers 2", "--workers 2: applies to a dataset; allowed with --rec"),
    ("no recording", f"{TRANSLATE} --recordings gone.h5", "gone.h5: "),
    ("a recording that is none", f"{TRANSLATE} --recordings file", "file: "),
    ("a recording without contact", f"{TRANSLATE} --recordings free.h5", "free.h5: no sample has a force of 0.1 N; "),
    ("two of one name", f"{RECORDED} --recordings full/a.h5", "--recordings: two files of one name; "),
    ("unknown split", f"{TRANSLATE} --split some", "--split 'some': allowed: train, validation, test"),
    ("unknown trajectory", f"{TRANSLATE} --trajectories 99", "d.zarr has no trajectory 99; it has 0 to 11"),
    ("no size", f"{TRANSLATE} --size small", "--size 'small': write it as WIDTHxHEIGHT, such as 480x640"),
    ("a size of nothing", f"{TRANSLATE} --size 0x0", "image of 0 x 0 pixels: allowed: 1 to 8192 each way"),
    ("no device", f"{TRANSLATE} --device gpu", "device 'gpu' is not allowed; allowed: cpu, cuda, cuda:N"),
    ("a GPU that is not there", f"{TRANSLATE} --device cuda:99", "cuda:99"),
    ("output another folder", f"{TRANSLATE} -o full", "full: exists already and holds no images of simgen; choose"),
    ("output a file", f"{TRANSLATE} -o file", "file: exists already and holds no images of simgen; choose"),
    ("output below a file", f"{TRANSLATE} -o file/deep", "file/deep: cannot be written: "),
    ("recordings into another folder", f"{RECORDED} -o full", "full: exists already and holds no images"),
    ("a dataset of other meshes", "translate networks ball.zarr --trajectories 0",
     "ball.zarr: biotac: 642 vertices; allowed: 324, as the "),
    ("of a recording's, too", "translate networks ball.zarr --recordings a.h5",
     "biotac: 642 vertices; allowed: 324, as "),
    ("another mesh of as many vertices", "translate networks other.zarr",
     "other.zarr: digit: another mesh of 642 vertices; allowed: the one that the networks were trained with"),
    ("a dataset of one sensor", "translate networks one.zarr",
     "one.zarr: no sensor biotac, which the networks know; it has"),
    ("nothing converged", "translate networks stalled.zarr",
     "stalled.zarr: no selected sample is valid on biotac"),
    ("nothing to render", "render stalled.zarr", "stalled.zarr: no selected sample is valid on digit"),
    ("trained on recordings", "translate recorded d.zarr",
     "recorded: was trained on recordings, in their unit; allowed: "),
    ("a damaged network", "translate damaged d.zarr --way ours",
     "network.safetensors: not the weights that damaged/rm2rm/network"),
]  # fmt: skip


@pytest.fixture(scope="module")
def world(with_electrodes, networks, tmp_path_factory) -> Path:
    """Datasets, networks and recordings, some of them bad."""
    folder = tmp_path_factory.mktemp("world")
    (folder / "d.zarr").symlink_to(with_electrodes.path)
    (folder / "networks").symlink_to(networks)
    run(fake.make_plan(fake.make_job()), folder / "ball.zarr", build=fake.fake_presser)
    one = fake.make_job(sensors={"digit": {"model": "digit"}}, trajectories={"count": 2})
    run(fake.make_plan(one), folder / "one.zarr", build=fake.fake_presser)
    shutil.copytree(with_electrodes.path, folder / "stalled.zarr")
    for sensor in ("biotac", "digit"):
        fake.change(Dataset(folder / "stalled.zarr"), f"{sensor}/status", ..., 1)
    shutil.copytree(with_electrodes.path, folder / "other.zarr")
    other = Dataset(folder / "other.zarr")
    fake.change(other, "digit/tetrahedra", ..., np.roll(other["digit/tetrahedra"], 1, axis=1))
    (folder / "ours").mkdir()
    for name in ("s2rm", "rmb", "rm2rm", "rmd"):
        (folder / "ours" / name).symlink_to(networks / name)
    shutil.copy(networks / "training.json", folder / "ours")
    (folder / "none").mkdir()
    shutil.copy(networks / "training.json", folder / "none")
    shutil.copytree(networks, folder / "damaged")
    with open(folder / "damaged" / "rm2rm" / "network.safetensors", "ab") as file:
        file.write(b"more")
    recorded(networks, folder / "recorded", remove_drift=True)
    touched.record(folder / "a.h5", 120, meshes=False)
    touched.record(folder / "free.h5", 20, meshes=False)
    with h5py.File(folder / "free.h5", "a") as file:
        file["force_vec/data"][...] = 0.0
    (folder / "file").write_text("anything")
    (folder / "full").mkdir()
    shutil.copy(folder / "a.h5", folder / "full")
    return folder


def recorded(networks: Path, folder: Path, **settings) -> None:
    """Copy networks as if they had been trained on recordings."""
    shutil.copytree(networks, folder)
    record = json.loads((folder / "training.json").read_text())
    record["job"]["signals"] = {"recordings": {"files": ["a.h5"], **settings}}
    (folder / "training.json").write_text(json.dumps(record))


@pytest.fixture
def folder(tmp_path, monkeypatch, world) -> Path:
    """The current folder, with links to all of the world."""
    for path in world.iterdir():
        (tmp_path / path.name).symlink_to(path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("command, words", rows(BAD))
def test_bad_input_is_one_line_and_writes_nothing(folder, world, monkeypatch, capfd, command, words):
    names, before = sorted(folder.iterdir()), contents(world)
    check_refusal(*simgen(command, monkeypatch, capfd), words)
    assert sorted(folder.iterdir()) == names and contents(world) == before


def test_an_imported_dataset_is_one_line(folder, monkeypatch, capfd):
    monkeypatch.setattr(Dataset, "imported", True)
    words = "d.zarr: imported, without touchable vertices and the sensors' models; allowed: a dataset that "
    check_refusal(*simgen(TRANSLATE, monkeypatch, capfd), words)


def test_presses_from_end_to_end(folder, with_electrodes, monkeypatch, capfd):
    """10 samples of 3 presses: images, intermediate results, GIFs, accuracy and the figure."""
    command = f"{TRANSLATE} {SMALL} --way ours --trajectories 3 --steps --workers 1"
    code, said, errors = simgen(command, monkeypatch, capfd)
    assert code == 0, errors
    made = folder / "d.translated"
    found = {path.relative_to(made).as_posix() for path in made.rglob("*") if path.is_file() and path.name != ".lock"}
    depths = {"sphere_7mm": 4, "ring_7mm": 2, "texture_14mm": 4}
    expected = {f"t0003_{name}/{file}" for name in depths for file in ("contact.csv", "steps.npz")}
    expected |= {"render.json", "contact.json", "chain.png"}
    expected |= {f"t0003_{name}/{k:02d}_0.{k + 1}mm.png" for name, count in depths.items() for k in range(count)}
    assert found == expected
    assert read_image(made / "t0003_ring_7mm" / "00_0.1mm.png").shape == (64, 48, 3)
    files = {name: [made / f"t0003_{name}" / "contact.csv"] for name in depths}
    about = json.loads((made / "contact.json").read_text())
    assert about["way"] == "ours" and list(about["groups"]) == [*depths, "all"]
    every = Accuracy.of([read_contact(file) for (file,) in files.values()])
    assert (about["groups"]["all"]["samples"], about["groups"]["all"]["near"]) == (10, every.near)
    assert "10 images made" in said and "0 existed" in said and "wrote d.translated/chain.png" in said
    (line,) = (line for line in said.splitlines() if line.lstrip().startswith("all"))
    assert line.split()[1:3] == ["10", f"{every.near:.1%}"]

    before = {path: path.stat().st_mtime_ns for path in made.rglob("*mm.png")}
    monkeypatch.setattr(view, "shown_presses", lambda selection: [10])  # the ring alone: less to draw
    code, said, errors = simgen(f"{command} --gif", monkeypatch, capfd)
    assert (
        code == 0 and "0 images made; 10 existed" in said and "wrote d.translated/t0003_ring_7mm/press.gif" in said
    )
    assert all(path.stat().st_mtime_ns == when for path, when in before.items())
    with Image.open(made / "t0003_ring_7mm" / "press.gif") as gif:
        assert gif.n_frames == depths["ring_7mm"]


def test_by_default_the_test_split_is_translated(folder, with_electrodes, monkeypatch, capfd):
    code, _, errors = simgen(f"{TRANSLATE} {SMALL} --way paper -o out --workers 1", monkeypatch, capfd)
    assert code == 0, errors
    of_test = with_electrodes["press/trajectory"][with_electrodes["press/split"] == 2]
    assert {int(path.name[1:5]) for path in (folder / "out").glob("t*")} == set(of_test.tolist())
    assert json.loads((folder / "out" / "render.json").read_text())["way"] == "paper"


def test_hypotheses_from_end_to_end(folder, networks, monkeypatch, capfd):
    """The likeliest is drawn without the option, too."""
    touched.spread(networks, folder / "spread")
    command = f"translate spread d.zarr {SMALL} --trajectories 3 --workers 1"
    monkeypatch.setattr(view, "shown_presses", lambda selection: [10])  # the ring alone: less to draw
    for options in ("-o one", "-o three --hypotheses 3"):
        code, said, errors = simgen(f"{command} {options}", monkeypatch, capfd)
        assert code == 0 and "10 images made" in said, errors
        assert (" any " in said) == ("3" in options)
    one, three = ({file.name for file in (folder / name / "t0003_ring_7mm").iterdir()} for name in ("one", "three"))
    assert {"00_0.1mm.png", "01_0.2mm.png", "contact.csv"} == one < three
    assert {"hypotheses.csv", "00_0.1mm.hypothesis2.png", "01_0.2mm.hypothesis2.png"} <= three - one
    for name in one - {"contact.csv"}:
        both = [(folder / output / "t0003_ring_7mm" / name).read_bytes() for output in ("one", "three")]
        assert both[0] == both[1]
    assert json.loads((folder / "one" / "render.json").read_text())["way"] == "points"
    words = "three: holds other images: hypotheses: 3 -> 2; choose another --output"
    check_refusal(*simgen(f"{command} -o three --hypotheses 2", monkeypatch, capfd), words)
    command = f"translate spread d.zarr --recordings a.h5 {SMALL} --samples 0:10 --hypotheses 2 -o recorded.out"
    code, said, errors = simgen(command, monkeypatch, capfd)
    assert code == 0 and "8 images made" in said, errors
    assert list((folder / "recorded.out" / "a" / "000000").glob("*.hypothesis2.png"))


def test_recordings_from_end_to_end(folder, networks, monkeypatch, capfd):
    """The job of these networks removes drift. 96 of 120 samples are in contact."""
    command = f"translate recorded d.zarr --recordings a.h5 {SMALL} --steps -o out"
    code, said, errors = simgen(f"{command} --samples 90:110", monkeypatch, capfd)
    assert code == 0, errors
    samples = [number for number in range(90, 110) if number % 5 != 4]
    out = folder / "out"
    found = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file() and path.name != ".lock"}
    images = {f"a/{number // 100 * 100:06d}/{number:06d}.png" for number in samples}
    assert found == images | {"a/000000/steps.npz", "a/000100/steps.npz", "render.json", "chain.png"}
    assert "16 images made" in said and "wrote out/chain.png" in said
    with h5py.File(folder / "a.h5") as file:
        stored = file["electrode_vals/data"][()]
    drift = np.linspace(0.0, 50.0, 120)[:, None] * np.arange(19)
    with np.load(out / "a" / "000100" / "steps.npz") as steps:
        np.testing.assert_allclose(steps["signals"], (stored - drift)[[n for n in samples if n >= 100]], rtol=1e-9)

    code, said, errors = simgen(f"{command} --samples 90:110", monkeypatch, capfd)
    assert code == 0 and "0 images made; 16 existed" in said
    before = contents(out)
    check_refusal(*simgen(command, monkeypatch, capfd), "out: holds other images: samples: [90, 110] -> None; choose")
    other = f"translate networks d.zarr --recordings a.h5 {SMALL} --steps -o out --samples 90:110"
    check_refusal(*simgen(other, monkeypatch, capfd), "settings.remove_drift: True -> False; choose another --output")
    with h5py.File(folder / "own.h5", "w") as file, h5py.File(folder / "a.h5") as old:
        for key in ("electrode_vals/data", "contact_loc/data", "force_vec/data"):
            file[key] = old[key][()] * 1.01
    (folder / "a.h5").unlink()
    (folder / "own.h5").rename(folder / "a.h5")
    words = "out: holds other images: recordings.a.h5"
    check_refusal(*simgen(f"{command} --samples 90:110", monkeypatch, capfd), words)
    assert contents(out) == before


def test_a_recording_in_motion(folder, monkeypatch, capfd):
    command = f"{RECORDED} {SMALL} --samples 3:6 --gif -o out"
    code, said, errors = simgen(command, monkeypatch, capfd)
    assert code == 0, errors
    with Image.open(folder / "out" / "a" / "motion.gif") as gif:
        assert gif.n_frames == 2  # number 4 is free
    assert "wrote out/a/motion.gif" in said
