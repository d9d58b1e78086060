"""The scripts of docs/clusters do what they say, with stand-ins for SLURM's own commands."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import fake
import pytest
import yaml

CLUSTERS = Path(__file__).resolve().parents[2] / "docs" / "clusters"

# What SLURM would do on two nodes, on this one. As there, sbatch has read the script when it returns: dask-jobqueue
# deletes it then.
COMMANDS = {
    "srun": 'for task in $(seq "${SLURM_NTASKS:-1}"); do "$@" & done; wait',
    "sbatch": 'script=$(< "${@: -1}"); bash -c "$script" > /dev/null 2>&1 & echo "Submitted batch job $!"',
    "scancel": 'kill "$@" 2> /dev/null; true',
    "simgen": f'exec {shlex.quote(sys.executable)} -m simgen.cli "$@"',
    "dask": f'exec {shlex.quote(sys.executable)} -m dask "$@"',
    "python": f'exec {shlex.quote(sys.executable)} "$@"',
}


@pytest.fixture
def slurm(tmp_path) -> dict[str, str]:
    """Environment with those commands."""
    folder = tmp_path / "bin"
    folder.mkdir()
    for name, text in COMMANDS.items():
        (folder / name).write_text(f"#!/bin/bash\n{text}\n")
        (folder / name).chmod(0o755)
    own = {"SLURM_JOB_ID": "4711", "SLURM_NTASKS": "2", "SLURM_MEM_PER_CPU": "3072", "TMPDIR": str(tmp_path)}
    return {**os.environ, **own, "PATH": f"{folder}{os.pathsep}{os.environ['PATH']}", "COLUMNS": "500"}


def test_the_slurm_script_makes_the_dataset(job, whole, tmp_path, slurm):
    command = ["bash", CLUSTERS / "slurm.sh", *job, "--output", tmp_path / "d.zarr"]
    ended = subprocess.run(command, env=slurm, cwd=tmp_path, capture_output=True, text=True, timeout=240)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert fake.contents(tmp_path / "d.zarr") == fake.contents(whole)
    assert not (tmp_path / "scheduler-4711.json").exists()


@pytest.mark.long
def test_the_jobqueue_script_makes_the_dataset(job, whole, tmp_path, slurm):
    command = [sys.executable, CLUSTERS / "jobqueue.py", "2", *job, "--output", tmp_path / "d.zarr"]
    own = {**slurm, "DASK_CONFIG": str(CLUSTERS / "jobqueue.yaml")}
    ended = subprocess.run(command, env=own, cwd=tmp_path, capture_output=True, text=True, timeout=240)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert fake.contents(tmp_path / "d.zarr") == fake.contents(whole)


def test_jobqueue_asks_for_what_its_file_says():
    import dask
    from dask_jobqueue import SLURMCluster

    config = yaml.safe_load((CLUSTERS / "jobqueue.yaml").read_text())
    with dask.config.set(dask.config.merge(dask.config.config, config)), SLURMCluster() as cluster:
        script, patience = cluster.job_script(), cluster.scheduler.worker_ttl
    assert {"#SBATCH --cpus-per-task=1", "#SBATCH --mem=3G", "#SBATCH -t 24:00:00", "#SBATCH --requeue",
            "export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1"} <= set(script.splitlines())  # fmt: skip
    assert "--nthreads 1 " in script and patience == 3600.0


def test_the_options_of_the_gpu_script_are_those_of_dask_cuda():
    cli = pytest.importorskip("dask_cuda.cli", reason="dask-cuda is not installed: it asks for its own version of dask")
    (line,) = re.findall(r"dask cuda worker ([^&]*)&", (CLUSTERS / "slurm_gpu.sh").read_text())
    cli.worker.make_context("worker", shlex.split(line))
