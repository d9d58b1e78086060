"""A job of eight presses that takes seconds, by the command line, in processes of their own."""

import fcntl
import os
import subprocess
import sys
from pathlib import Path

import meshio
import pytest
from sensors.slab import SLAB, write_sensor

from simgen.verification.validate import meshes

# A slab of 243 vertices, linear elements and one depth: these tests are about files. The slab has its own tetrahedra,
# since the mesher makes others each time, and on some of them contact is too coarse for the audit.
SENSOR = {
    **SLAB,
    "gel": {"mesh": {"file": "slab.vtu", "unit": "mm"}},
    "held": {"back": {"plane": {"axis": "y", "at_mm": 4.0}}},
    "meshes": {"default": "as_given"},
}
PRESSES = [
    "trajectories.count=4", "indenters=[sphere_14mm, sphere_7mm]", "depths_mm={first: 0.25, last: 0.25, count: 1}",
    "solver.element=P1",
]  # fmt: skip
SHARDS = 8


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
def shared(tmp_path_factory, worker_id) -> Path:
    """A folder with the slab, `slab`, and the dataset of an undisturbed run. Processes of one test run share it."""
    own = tmp_path_factory.getbasetemp()
    folder = (own if worker_id == "master" else own.parent) / "crash"
    folder.mkdir(exist_ok=True)
    with open(folder / "lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "whole.zarr").exists():
            slab = write_sensor(folder / "slab", SENSOR)
            nodes, tetrahedra, corners, _ = meshes.box((8, 2, 8), (16.0, 4.0, 16.0))
            meshio.Mesh(nodes[:corners], [("tetra", tetrahedra[:, :4])]).write(slab / "slab.vtu")
            ended = simgen("run", *job_in(folder), "--output", folder / "whole.zarr", "--scheduler", "sync")
            assert ended.returncode == 0, ended.stderr
    return folder


def job_in(folder: Path) -> list[str]:
    return ["smoke", f"sensors={{slab: {{model: {folder / 'slab'}}}}}", *PRESSES]


@pytest.fixture(scope="session")
def job(shared) -> list[str]:
    """The job and its overrides."""
    return job_in(shared)


@pytest.fixture(scope="session")
def whole(shared) -> Path:
    """The dataset of an undisturbed run."""
    return shared / "whole.zarr"
