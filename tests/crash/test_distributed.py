"""A scheduler and workers of dask as processes of their own, that come and go while a run goes on."""

import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import fake
import psutil
import pytest

from tests.crash.conftest import SHARDS, start

SEED, KILLS = 5, 50
LOOPBACK = ["--host", "127.0.0.1", "--no-dashboard"]


class Cluster:
    """Processes of `dask scheduler` and `dask worker` on this machine, each at the head of a group of its own."""

    def __init__(self, folder: Path):
        self.folder, self.file, self.processes = folder, folder / "scheduler.json", []

    def _start(self, *arguments: str | Path) -> subprocess.Popen:
        with open(self.folder / f"{len(self.processes)}.log", "w") as log:
            command = [sys.executable, "-m", "dask", *map(str, arguments)]
            process = subprocess.Popen(command, stdout=log, stderr=log, cwd=self.folder, start_new_session=True)
        self.processes.append(process)
        return process

    def scheduler(self, port: int = 0) -> tuple[subprocess.Popen, str]:
        """Start one; its process and its address."""
        self.file.unlink(missing_ok=True)
        process = self._start("scheduler", *LOOPBACK, "--port", str(port), "--scheduler-file", self.file)
        wait_for(self.file.exists)
        wait_for(lambda: re.search(r"tcp://127.0.0.1:\d+", self.file.read_text()))
        return process, re.search(r"tcp://127.0.0.1:\d+", self.file.read_text())[0]

    def worker(self) -> subprocess.Popen:
        return self._start("worker", "--scheduler-file", self.file, *LOOPBACK, "--nthreads", "1", "--no-nanny")

    def close(self) -> None:
        for process in self.processes:
            kill(process)


def wait_for(condition, seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def kill(process: subprocess.Popen) -> None:
    """kill -9 of a process and of all that it has started, at once."""
    if process.poll() is None:
        family = psutil.Process(process.pid).children(recursive=True)
        os.killpg(process.pid, signal.SIGKILL)
        for each in family:
            if each.is_running():
                each.kill()
    process.wait()


def shards(path: Path) -> int:
    return len(list(path.glob("manifest/0*.json")))


@pytest.fixture
def cluster(tmp_path):
    cluster = Cluster(tmp_path)
    yield cluster
    cluster.close()


def test_workers_join_and_are_killed_while_a_run_goes_on(job, whole, tmp_path, cluster):
    """The first worker joins a run that waits for one, a second joins, the first is killed, a third joins."""
    path = tmp_path / "d.zarr"
    _, address = cluster.scheduler()
    process = start("run", *job, "--output", path, "--scheduler", address)
    wait_for(path.exists)
    first = cluster.worker()
    wait_for(lambda: shards(path) >= 1)
    cluster.worker()
    wait_for(lambda: shards(path) >= 3)
    kill(first)
    cluster.worker()
    output, errors = process.communicate(timeout=240)
    assert process.returncode == 0, output + errors
    assert f"no worker yet at {address}" in output
    assert fake.contents(path) == fake.contents(whole)


def test_a_scheduler_that_is_killed_is_one_line_and_with_another_the_command_goes_on(job, whole, tmp_path, cluster):
    path = tmp_path / "d.zarr"
    scheduler, _ = cluster.scheduler()
    command = ["run", *job, "--output", path, "--scheduler-file", cluster.file]
    worker = cluster.worker()
    process = start(*command)
    wait_for(lambda: shards(path) >= 2)
    kill(scheduler)
    output, errors = process.communicate(timeout=120)
    assert process.returncode == 2 and "Traceback" not in output + errors, output + errors
    (line,) = [line for line in errors.splitlines() if line.startswith("simgen: ")]
    assert "the scheduler of the workers is lost" in line
    assert 0 < shards(path) < SHARDS
    kill(worker)
    cluster.scheduler()
    cluster.worker()
    process = start(*command)
    output, errors = process.communicate(timeout=240)
    assert process.returncode == 0, output + errors
    assert "1 worker with 1 threads at tcp://127.0.0.1" in output
    assert fake.contents(path) == fake.contents(whole)


@pytest.mark.long
def test_a_run_that_is_killed_leaves_its_scheduler_free_for_the_next(job, whole, tmp_path, cluster):
    """What its worker was at may still be written; the next run waits for that, and does the rest."""
    path = tmp_path / "d.zarr"
    _, address = cluster.scheduler()
    cluster.worker()
    command = ["run", *job, "--output", path, "--scheduler", address]
    process = start(*command)
    wait_for(lambda: shards(path) >= 2)
    kill(process)
    process = start(*command)
    output, errors = process.communicate(timeout=240)
    assert process.returncode == 0, output + errors
    assert fake.contents(path) == fake.contents(whole)


@pytest.mark.long
def test_whatever_is_killed_the_same_command_ends_with_the_same_bytes(job, whole, tmp_path, cluster):
    """Fifty times a scheduler, a worker or the run itself, between a run's first shard and its last."""
    chance, path, ended, killed = random.Random(SEED), tmp_path / "d.zarr", 0, []
    scheduler, _ = cluster.scheduler()
    workers = [cluster.worker(), cluster.worker()]
    for number in range(KILLS + 1):  # the last is left alone
        process = start("run", *job, "--output", path, "--scheduler-file", cluster.file)
        what, after = chance.choice(("scheduler", "worker", "run")), chance.randrange(SHARDS)
        while process.poll() is None and (number == KILLS or shards(path) < after):
            time.sleep(0.02)
        if process.poll() is None:
            killed.append((what, shards(path)))
            if what == "run":
                kill(process)
            elif what == "worker":
                kill(workers.pop(0))
                workers.append(cluster.worker())
            else:
                kill(scheduler)
        output, errors = process.communicate(timeout=240)
        assert process.returncode in (0, 2, -signal.SIGKILL) and "Traceback" not in output + errors, (killed, errors)
        if what == "scheduler":
            for each in (scheduler, *workers):
                kill(each)
            scheduler, _ = cluster.scheduler()
            workers = [cluster.worker(), cluster.worker()]
        if process.returncode == 0:
            assert fake.contents(path) == fake.contents(whole), killed
            shutil.rmtree(path)
            ended += 1
    print(f"killed, and how many of {SHARDS} shards were there: {killed}; ended {ended} times")
    assert process.returncode == 0 and {what for what, _ in killed} == {"scheduler", "worker", "run"}
