"""A job of twelve presses that takes seconds, by the command line, in processes of their own."""

import fcntl
import os
import subprocess
import sys
from pathlib import Path

import pytest

# Linear elements and one depth: these tests are about files, and a press takes a tenth of a second.
JOB = [
    "smoke", "sensors={digit: {model: digit, mesh: coarse}}", "trajectories.count=4",
    "depths_mm={first: 0.1, last: 0.1, count: 1}", "solver.element=P1",
]  # fmt: skip
SHARDS = 12


def start(*arguments: str | Path, **options) -> subprocess.Popen:
    """The command line, at the head of a process group of its own."""
    command = [sys.executable, "-m", "simgen.cli", *map(str, arguments)]
    environment = {**os.environ, "COLUMNS": "500"}  # no message is broken into lines
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, env=environment, start_new_session=True, **{**streams, **options})


def simgen(*arguments: str | Path, **options) -> subprocess.CompletedProcess:
    """The command line to its end."""
    process = start(*arguments, **options)
    output, errors = process.communicate(timeout=300)
    return subprocess.CompletedProcess(arguments, process.returncode, output, errors)


@pytest.fixture(scope="session")
def whole(tmp_path_factory, worker_id) -> Path:
    """The dataset of an undisturbed run. Processes of one test run share it."""
    own = tmp_path_factory.getbasetemp()
    path = (own if worker_id == "master" else own.parent) / "whole.zarr"
    with open(path.with_suffix(".lock"), "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not path.exists():
            ended = simgen("run", *JOB, "--output", path, "--workers", "2")
            assert ended.returncode == 0, ended.stderr
    return path
