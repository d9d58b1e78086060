"""The command line: help, exit codes, one line for bad input. Some commands are processes, as a user runs them."""

import json
import os
import re
import subprocess
import sys

import numpy as np
import pytest
import refusal

from simgen import __version__
from simgen.cli.console import console
from simgen.config.resources import resource
from simgen.dataset.loading import load_dataset
from simgen.dataset.reader import Dataset
from simgen.fem.nonlinear.status import Status
from simgen.sensors import pairing


def simgen(*arguments, cwd) -> subprocess.CompletedProcess:
    """A process of the command line."""
    command = [sys.executable, "-m", "simgen.cli", *map(str, arguments)]
    environment = {**os.environ, "COLUMNS": "100"}
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=environment, timeout=120)


@pytest.fixture
def here(tmp_path, monkeypatch, capfd):
    """The command line in this process and an empty folder: exit code, output, errors."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setattr(console, "width", 100)
    return lambda *arguments: refusal.simgen([*map(str, arguments)], monkeypatch, capfd)


@pytest.fixture
def dataset(fake_dataset):
    return fake_dataset.path


@pytest.mark.parametrize(
    "command, words",
    [
        ([], ["run", "mesh", "check", "report", "jobs/smoke.yaml"]),
        (["run"], ["JOB", "--output", "--workers", "--scheduler", "--device", "--dry-run"]),
        (["mesh"], ["SENSOR", "quality gates"]),
        (["check"], ["DATASET", "Exit code 1"]),
        (["report"], ["DATASET", "--output", "HTML"]),
        (["export"], ["DATASET", "--format", "across, biotac_sim, npy or vtk", "--trajectories", "--split"]),
        (["import"], ["FILE...", "--mesh", "SENSOR=FILE", "--depths-mm"]),
    ],
)
def test_help_says_what_there_is(here, command, words):
    code, output, _ = here(*command, "--help")
    assert code == 0
    for word in words:
        assert word in output


def test_help_lists_every_bundled_job(here):
    bundled = {file.stem for file in resource("jobs").glob("*.yaml")}
    named = {command: here(command, "--help")[1] for command in ("run", "train")}
    listed = {command: set(re.findall(r"\w+", re.search(r"a bundled (?:job|one): ([^.]+)", text)[1]))
              for command, text in named.items()}  # fmt: skip
    assert listed["run"] | listed["train"] == bundled and not listed["run"] & listed["train"]


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["run", "nothing.yaml"], "nothing.yaml: no such job file; bundled jobs:"),
        (["run", "smoke", "seed=-1"], "override seed=-1: seed: -1 is not allowed; allowed: a whole number"),
        (["run", "smoke", "sensors.digit.model=finger", "--dry-run"], "finger"),
        (["run", "smoke", "depths_mm.last=3.2", "--dry-run"], "digit: 0 of 2 contacts fit after 256 proposals"),
        (["run", "smoke", "--scheduler", "nowhere"], "scheduler 'nowhere': missing port number"),
        (["run", "smoke", "--device", "gpu"], "device 'gpu' is not allowed; allowed: cpu, cuda, cuda:N"),
        (["run", "smoke", "--device", "gpu", "--dry-run"], "device 'gpu' is not allowed; allowed: cpu,"),
        (["run", "smoke", "--device", "cuda:99"], "device 'cuda:99': this machine has"),
        (["check", "."], ".: not a dataset"),
        (["report", "."], ".: not a dataset"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(here, monkeypatch, arguments, words):
    monkeypatch.setattr(pairing, "BLOCK", 16)  # of 16 blocks that are proposed in vain
    refusal.check_refusal(*here(*arguments), words)


def test_a_dry_run_says_how_many_contacts_leave_too_little_gel(here):
    digit = "sensors={digit: {model: digit, mesh: coarse}}"
    command = ["run", "smoke", digit, "trajectories.count=20", "depths_mm.last=2", "--dry-run"]
    _, output, _ = here(*command)
    refused = re.search(r"all 20 fit; (\d+\.\d)% of the proposals would leave less than 0.15 of the gel", output)
    assert 5.0 < float(refused[1]) < 50.0, output
    given = "contacts=[{x_mm: -6, arc_mm: 0}, {x_mm: -8, arc_mm: 0}]"
    for change in ("least_thickness_left=0", "too_thin=stop", given):
        _, output, _ = here(*command, "trajectories.count=2", f"trajectories.{change}")
        assert "all 2 fit" in output and "proposals" not in output


def test_presses_that_would_leave_too_little_gel_end_as_planned(here, tmp_path):
    """Geometry determines the last step. Here some presses end before the first step, and others never end."""
    thin = ["trajectories.too_thin=stop", "trajectories.least_thickness_left=0.925"]
    depths = "depths_mm={first: 0.2, last: 0.8, count: 4}"
    indenters = "indenters=[sphere_7mm, ring_7mm]"
    command = "run", "smoke", *thin, depths, indenters, "--scheduler", "sync"
    code, output, errors = here(*command, "--check")
    assert code == 0 and "smoke.zarr passes" in output and "next: simgen report" in output, errors
    dataset = Dataset(tmp_path / "smoke.zarr")
    steps, status = (np.stack([dataset[f"{sensor}/{name}"] for sensor in ("digit", "biotac")])
                     for name in ("pressable_steps", "status"))  # fmt: skip
    assert steps.min() == 0 and steps.max() == 4
    ends = np.arange(4) >= steps[:, :, None]
    np.testing.assert_array_equal(status, np.where(ends, Status.NO_ROOM, Status.CONVERGED))
    assert len(load_dataset(dataset.path)) == steps.min(axis=0).sum()

    planned, sentence = np.count_nonzero(ends), Status.NO_ROOM.sentence
    words = f"smoke.zarr: 4 of 4 presses; no samples failed, {planned} not pressed, as planned"
    assert words in output.splitlines()
    code, output, _ = here("status", "smoke.zarr")
    assert code == 0 and output.splitlines()[-1] == f"{planned} samples not pressed: {sentence}"
    code, output, _ = here("check", "smoke.zarr", "--json", "found.json")
    assert code == 0, output
    found = json.loads((tmp_path / "found.json").read_text())
    for sensor, own in zip(("digit", "biotac"), ends, strict=True):
        rows = {each["what"]: each for each in found if each["subject"] == sensor}
        left = own.size - own.sum()
        assert rows["samples converged"]["found"] == f"{left} of {left}"
        assert rows["not pressed, as planned"]["found"] == f"{own.sum()} of {own.size}"
    code, _, errors = here("report", "smoke.zarr")
    assert code == 0, errors
    spheres, rings = ends[0, :, -1].reshape(2, 2).sum(axis=0)
    row = f"<td>digit</td><td>not pressed</td><td>{sentence}</td><td>{spheres}</td><td>{rings}</td>"
    assert row in (tmp_path / "smoke.html").read_text()

    file = tmp_path / "smoke.zarr/digit/force/c/0/0/0"
    file.write_bytes(file.read_bytes() + b"x")
    for options, expected in (((), 0), (("--check",), 1)):
        code, output, _ = here(*command, *options)
        assert code == expected and ("checksums" in output) == ("FAIL" in output) == bool(options)


def test_check_passes_a_sound_dataset_and_fails_a_broken_one(here, dataset, tmp_path):
    code, output, _ = here("check", dataset)
    assert code == 0, output
    assert "passes" in output
    (dataset / "manifest" / "000000.json").rename(tmp_path / "000000.json")
    done = simgen("check", dataset, cwd=tmp_path)
    (tmp_path / "000000.json").rename(dataset / "manifest" / "000000.json")
    assert done.returncode == 1
    assert "FAIL" in done.stdout
    assert "10 of 12" in done.stdout


def test_check_writes_its_findings(here, dataset, tmp_path):
    code, _, errors = here("check", dataset, "--json", "found.json")
    assert code == 0, errors
    found = json.loads((tmp_path / "found.json").read_text())
    assert all(each["passed"] in (True, None) for each in found)
    assert {"subject": "dataset", "what": "presses", "found": "12 of 12", "allowed": "all"}.items() <= found[0].items()
    code, _, errors = here("check", dataset, "--json", "nowhere/found.json")
    assert code == 2
    assert errors == "simgen: nowhere/found.json: cannot be written: No such file or directory\n"


def test_report_writes_one_page_named_after_the_dataset(here, dataset, tmp_path):
    code, _, errors = here("report", dataset)
    assert code == 0, errors
    assert (tmp_path / "d.html").is_file()


def test_the_version_is_that_of_the_package(tmp_path):
    done = simgen("--version", cwd=tmp_path)
    assert done.returncode == 0 and done.stdout == f"simgen {__version__}\n"


TWO_FAIL = """
import asyncio, gc
from simgen.cli import app
from simgen.errors import InputError

async def fail():
    raise OSError("full")

async def write():
    tasks = [asyncio.create_task(fail()) for _ in range(2)]
    await asyncio.sleep(0.01)
    await tasks[0]

def command():
    try:
        asyncio.run(write())
    except OSError:
        pass
    gc.collect()  # asyncio complains when it forgets the other task
    raise InputError("the disk is full")

app.app = command
app.main()
"""


def test_of_several_tasks_that_fail_one_error_is_printed():
    ended = subprocess.run([sys.executable, "-c", TWO_FAIL], capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (2, "simgen: the disk is full\n")
