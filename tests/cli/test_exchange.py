"""`simgen export` and `simgen import`: what they print, and one line with exit code 2 for bad input."""

import os
import subprocess
import sys

import fake
import h5py
import numpy as np
import pytest

from simgen.cli import app as cli
from simgen.dataset.atomic_files import ROOM
from simgen.dataset.exchange.exporting import FORMATS, export
from simgen.dataset.reader import Dataset


@pytest.fixture
def simgen(monkeypatch, tmp_path, capsys):
    """Run the command line in an empty folder; return exit code, output and error output."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["simgen", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        printed = capsys.readouterr()
        return ended.value.code or 0, printed.out, printed.err

    return run


@pytest.fixture(scope="module")
def results(stalled_dataset, tmp_path_factory):
    """An export in the layout of ACROSS, and files that are no result files."""
    folder = tmp_path_factory.mktemp("results") / "out"
    export(stalled_dataset, "across", folder)
    (folder / "empty.hdf5").touch()
    (folder / "text.hdf5").write_text("no HDF5")
    with h5py.File(folder / "electrodes.hdf5", "w") as file:
        file["electrode_vals/data"] = np.zeros((2, 19))
    with h5py.File(folder / "results_digit_fake.hdf5") as source, h5py.File(folder / "nan.hdf5", "w") as file:
        source.copy("trial_1", file)
        file["trial_1/step_0/nodal_coords_digit/env_0"][7, 1] = np.nan
    return folder


@pytest.mark.parametrize("format", FORMATS)
def test_export_and_import_say_what_they_did(stalled_dataset, simgen, tmp_path, format):
    code, said, _ = simgen("export", stalled_dataset.path, "--format", format, "-o", "out", "--trajectories", "0:1")
    files = [path for path in (tmp_path / "out").rglob("*") if path.is_file()]
    assert code == 0 and f"out: {len(files)} files" in said and "10 of 12 samples on digit and biotac" in said
    if format in ("across", "biotac_sim"):
        meshes = [f"--mesh={sensor}=out/rest_{sensor}.vtu" for sensor in stalled_dataset.sensors]
        code, said, _ = simgen("import", *(tmp_path / "out").glob("*.hdf5"), *meshes, "-o", "back.zarr")
        assert code == 0 and "biotac: 10 of 12 samples" in said
        assert Dataset("back.zarr").job.name == "fake"
        assert simgen("check", "back.zarr")[0] == 0
        code, _, complaint = simgen("report", "back.zarr")
        assert code == 2 and "see simgen check" in complaint


EXPORT = ["export", "{dataset}", "--format", "npy", "--output", "out"]
IMPORT = ["import", "{results}/results_digit_fake.hdf5", "--output", "out"]
DIGIT, BIOTAC = "--mesh=digit={results}/rest_digit.vtu", "--mesh=biotac={results}/rest_biotac.tet"


@pytest.mark.parametrize(
    "arguments, complaint",
    [
        (["export", "nothing.zarr", "--format", "npy", "--output", "out"], "nothing.zarr: not a dataset"),
        (["export", "{dataset}", "--format", "hdf5", "--output", "out"], "allowed: across, biotac_sim, npy, vtk"),
        ([*EXPORT, "--sensor", "finger"], "--sensor 'finger': "),
        ([*EXPORT, "--trajectories", "2:5"], "has no trajectory 4; it has 0 to 3"),
        ([*EXPORT, "--trajectories", "2-5"], "--trajectories '2-5': write it as 0:10"),
        ([*EXPORT, "--split", "all"], "--split 'all': allowed: train, validation, test"),
        ([*EXPORT[:-1], "taken"], "taken: exists already; remove it, or choose another --output"),
        ([*EXPORT[:-1], "taken/file"], "taken/file: exists already"),
        ([*EXPORT[:-1], "taken/file/out"], "taken/file/out: cannot be written: Not a directory"),
        ([*IMPORT], "--mesh: missing; give SENSOR=FILE for each sensor"),
        ([*IMPORT, "--mesh", "{results}/rest_digit.vtu"], "write it as SENSOR=FILE"),
        ([*IMPORT, DIGIT, DIGIT], "sensor 'digit' has one already"),
        ([*IMPORT, "--mesh=digit=nothing.vtu"], "nothing.vtu: no such mesh file"),
        ([*IMPORT, "--mesh=digit={results}/results_digit_fake.hdf5"], "unknown kind of mesh '.hdf5'"),
        ([*IMPORT, "--mesh=digit=surface.stl"], "surface.stl: holds no tetrahedra"),
        ([*IMPORT, "--mesh=digit=other.tet"], "642 vertices, but the mesh of digit has 4"),
        ([*IMPORT, BIOTAC], "sensor 'digit' has no --mesh; there are biotac"),
        ([*IMPORT, DIGIT, BIOTAC], "no file of sensor 'biotac' is given"),
        ([*IMPORT, DIGIT, "--name", "a b"], "--name: name: \"a b\" is not allowed"),
        ([*IMPORT, DIGIT, "--depths-mm", "1,2,3"], "--depths-mm '1,2,3': write it as first:last:count"),
        ([*IMPORT[:-1], "taken", DIGIT], "taken: exists already"),
        (["import", "nothing.hdf5", "--output", "out", DIGIT], "nothing.hdf5: cannot be read as HDF5"),
        (["import", "{results}/empty.hdf5", "--output", "out", DIGIT], "empty.hdf5: cannot be read as HDF5"),
        (["import", "{results}/text.hdf5", "--output", "out", DIGIT], "text.hdf5: cannot be read as HDF5"),
        (["import", "{results}/electrodes.hdf5", "--output", "out", DIGIT], "neither trial_<i> (ACROSS) nor step_<j>"),
        (["import", "{results}/nan.hdf5", "--output", "out", DIGIT], "env_0: values that are not finite numbers"),
    ],
)  # fmt: skip
def test_bad_input_is_one_line_and_leaves_nothing(stalled_dataset, results, simgen, tmp_path, arguments, complaint):
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken/file").touch()
    (tmp_path / "other.tet").write_text("v 0 0 0\nv .01 0 0\nv 0 .01 0\nv 0 0 .01\nt 0 1 2 3\n")
    fake.BALL.export(tmp_path / "surface.stl")
    before = sorted(tmp_path.rglob("*"))
    code, _, said = simgen(*(text.format(dataset=stalled_dataset.path, results=results) for text in arguments))
    assert code == 2, said
    assert said.startswith("simgen: ") and len(said.splitlines()) == 1
    assert complaint in said
    assert sorted(tmp_path.rglob("*")) == before


SCRIPT = """
mount -t tmpfs -o size=$1 tmpfs /mnt
shift; "$@"
echo "exit code $?, left: $(ls -A /mnt)"
"""


@pytest.mark.parametrize("free_kilobytes", [40, 400])
@pytest.mark.parametrize("what", [*FORMATS, "import"])
def test_a_full_disk_is_one_line_and_leaves_nothing(stalled_dataset, results, what, free_kilobytes):
    """The file system is full from the start, or fills up: each command writes more than 400 kB."""
    private = ["unshare", "--mount", "--map-root-user", "bash", "-c"]
    if subprocess.run([*private, "mount -t tmpfs tmpfs /mnt"], capture_output=True).returncode:
        pytest.skip("no file system can be mounted here (unshare --mount --map-root-user)")
    arguments = ["export", stalled_dataset.path, "--format", what, "--trajectories", "0:4"]
    if what == "import":
        arguments = ["import", results / "results_digit_fake.hdf5", f"--mesh=digit={results}/rest_digit.vtu"]
        free_kilobytes //= 2
    kept_free = 0 if what in ("npy", "import") else ROOM // 1024  # for HDF5 and VTK
    command = [sys.executable, "-m", "simgen.cli", *map(str, arguments), "-o", "/mnt/out"]
    ended = subprocess.run([*private, SCRIPT, "bash", f"{kept_free + free_kilobytes}k", *command],
                           capture_output=True, text=True, env={**os.environ, "COLUMNS": "500"})  # fmt: skip
    assert ended.stderr.strip() == "simgen: /mnt/out: cannot be written: No space left on device"
    assert ended.stdout.strip().endswith("exit code 2, left:")
