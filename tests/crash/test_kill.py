"""kill -9 at random moments: whatever is killed, the same command ends with the bytes of an undisturbed run."""

import os
import random
import shutil
import signal
import subprocess
import time
from pathlib import Path

import fake
import psutil
import pytest

from tests.crash.conftest import SHARDS, start

SEED = 5
START, SHARD = 4.0, 0.05  # s: until there is work, and from one shard to the next, on a quick machine


def descendants(pid: int) -> list[psutil.Process]:
    try:
        return psutil.Process(pid).children(recursive=True)
    except psutil.NoSuchProcess:
        return []


def workers_among(processes: list[psutil.Process]) -> list[psutil.Process]:
    found = []
    for process in processes:
        try:
            if "forkserver" in " ".join(process.cmdline()):
                found.append(process)
        except psutil.Error:  # it has ended
            continue
    return found


def kill(process, what: str, chance: random.Random) -> None:
    """kill -9 the run's own process, a worker or what workers are forked from, or all at once."""
    if what == "all":
        os.killpg(process.pid, signal.SIGKILL)
    elif what == "run":
        process.kill()
    elif found := workers_among(descendants(process.pid)):
        chance.choice(found).kill()


def wait_for_the_moment(process, path: Path, at_work: bool, chance: random.Random) -> bool:
    """Wait for any moment of a run, or for one between its first shard and its last; False if it has ended before."""
    shards = chance.randrange(1, SHARDS // 2) if at_work else 0
    while process.poll() is None and len(list(path.glob("manifest/0*.json"))) < shards:
        time.sleep(0.01)
    try:
        process.wait(timeout=chance.uniform(0.0, SHARD if at_work else START))
    except subprocess.TimeoutExpired:
        return True
    return False


@pytest.mark.parametrize("kills", [2, pytest.param(50, marks=pytest.mark.long)])
def test_the_same_command_ends_with_the_same_bytes(job, whole, tmp_path, kills):
    chance, path, expected, ended, killed = random.Random(SEED), tmp_path / "d.zarr", fake.contents(whole), 0, []
    for number in range(kills + 1):  # the last is left alone
        process = start("run", *job, "--output", path, "--workers", "2")
        what = ("run", "all", "worker")[number % 3]
        if number < kills and wait_for_the_moment(process, path, number % 2 == 1, chance):
            killed.append((what, len(list(path.glob("manifest/0*.json")))))
            family = descendants(process.pid)
            kill(process, what, chance)
            if what == "run":  # its workers notice, and end by themselves
                _, alive = psutil.wait_procs(family, timeout=30)
                assert not alive
        output, errors = process.communicate(timeout=120)
        if process.returncode != -signal.SIGKILL:
            assert process.returncode == 0, f"kill {number}: {killed}, {output}{errors}"
            assert fake.contents(path) == expected, f"kill {number}: {killed}"
            assert not (path / ".staging").exists()
            ended += 1
            if number < kills:
                shutil.rmtree(path)
    print(f"killed, and how many of {SHARDS} shards were there: {killed}; ended {ended} times")
    assert ended and any(0 < shards < SHARDS for _, shards in killed)
    assert not list(tmp_path.glob(".*.partial"))
