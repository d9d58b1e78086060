"""Local clusters: processes of GPUs, processes that are killed as they start, and what dask imports."""

import os
import subprocess
import sys

import fake
import psutil
import pytest
from dask.distributed import Client
from distributed import utils

import simgen.pipeline.local_cluster
from pipeline.tasks import reciprocal
from simgen.errors import InputError
from simgen.pipeline import shard_files
from simgen.pipeline.local_cluster import TASKS_PER_GPU_PROCESS, local_cluster
from simgen.pipeline.workers import start_workers

DIES = """
import os, pathlib, signal
for lot in pathlib.Path({folder!r}).iterdir():
    try:
        lot.unlink()
    except FileNotFoundError:  # another was faster
        continue
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_local_cluster_is_patient_with_long_calls(client):
    """A mesh may take minutes in one call that lets no heartbeat through; dask's own limit is five."""
    found = client.run_on_scheduler(lambda dask_scheduler: (
        dask_scheduler.worker_ttl, dask_scheduler.allowed_failures, dask_scheduler.no_workers_timeout))  # fmt: skip
    assert found == (3600.0, 2, 300.0)


@pytest.fixture
def dying(tmp_path, monkeypatch):
    """Kill so many of the processes that start from now on, before they are workers."""
    monkeypatch.setattr(simgen.pipeline.local_cluster, "IGNORE_INTERRUPTS", DIES.format(folder=str(tmp_path)))
    return lambda times: [(tmp_path / str(number)).touch() for number in range(times)]


def test_a_process_that_is_killed_as_it_starts_is_started_again(dying):
    dying(2)
    with start_workers(fake.make_job(), count=2, build=fake.fake_presser) as started:
        assert dict(started.map(reciprocal, [2, 4])) == {2: 0.5, 4: 0.25}
        assert len(started.started[0].nthreads()) == 2


def test_processes_that_never_start_are_one_line(dying, client):
    dying(6)
    assert client.nthreads()  # the process that workers are forked from is there, and stays
    before = set(psutil.Process().children(recursive=True))
    once = pytest.raises(InputError, match="one of 1 workers did not start: killed or out of memory 3 times")
    with start_workers(fake.make_job(), count=1, build=fake.fake_presser) as started, once:
        _ = started.started
    assert set(psutil.Process().children(recursive=True)) <= before


def writes_by() -> str:
    with shard_files.writing() as threads:
        assert threads._threads.submit(lambda: threads._connection() and threads._own.process.is_alive()).result()
        return type(threads).__name__


def test_every_gpu_has_a_worker_that_sees_no_other_and_processes_that_write():
    """Environments reach the processes before anything is imported there."""
    with local_cluster([{"CUDA_VISIBLE_DEVICES": name} for name in ("3", "5")]) as cluster, Client(cluster) as client:
        client.wait_for_workers(2)
        seen = client.run(lambda: os.environ["CUDA_VISIBLE_DEVICES"])
        assert sorted(seen.values()) == ["3", "5"]
        assert set(client.nthreads().values()) == {TASKS_PER_GPU_PROCESS}
        assert set(client.run(writes_by).values()) == {"WritingProcesses"}
        processes = client.run(os.getpid).values()
    assert not any(psutil.pid_exists(process) for process in processes)


IMPORTS_OF_DASK = """
import sys
from simgen.pipeline.local_cluster import local_cluster
if __name__ == "__main__":
    with local_cluster([{}]) as cluster:
        print(len(cluster.workers), "pandas" in sys.modules)
"""


def test_dask_imports_no_pandas(tmp_path):
    """It would import pandas, if it is there, before it starts processes."""
    assert hasattr(utils, "_forkserver_preload_set")  # dask may rename it, and then the import comes back
    (tmp_path / "pandas.py").touch()
    script = tmp_path / "script.py"
    script.write_text(IMPORTS_OF_DASK)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])}
    done = subprocess.run([sys.executable, script], env=environment, capture_output=True, text=True, timeout=120)
    assert done.stdout.split() == ["1", "False"], done.stderr
