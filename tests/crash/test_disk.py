"""A disk that is full, a folder that may not be written, files that rot: one line says so, and nothing is lost."""

import ctypes
import os
import re
import shutil
import subprocess
import sys

import fake
import pytest

from tests.crash.conftest import SHARDS, simgen

CAP_DAC_OVERRIDE, PR_CAPBSET_DROP = 1, 24
ALONE = ["--scheduler", "sync"]


def obey_permissions() -> None:
    """Even root may then write only where permissions allow it: for what is started next."""
    if os.geteuid() == 0 and ctypes.CDLL(None, use_errno=True).prctl(PR_CAPBSET_DROP, CAP_DAC_OVERRIDE) != 0:
        raise OSError(ctypes.get_errno(), "prctl")


def one_line(ended: subprocess.CompletedProcess) -> str:
    """What a command that refused said, which is a single line."""
    assert ended.returncode == 2, ended.stdout + ended.stderr
    assert "Traceback" not in ended.stdout + ended.stderr
    (line,) = ended.stderr.strip().splitlines()
    return line


SCRIPT = """
mount -t tmpfs -o size=$1k tmpfs /mnt
folder=$2; shift 2
run() { "$@" --scheduler sync --output /mnt/d.zarr; }
run "$@"
code=$? there=$(find /mnt -type f | wc -l)
echo "exit code $code, shards $(find /mnt -path '*/manifest/0*' | wc -l), files $there"
mount -o remount,size=64m /mnt
if [ $there = 0 ]; then exit; fi # a run into an empty folder is what all other tests are about
run "$@" > /dev/null && cp -r /mnt/d.zarr $folder
"""


@pytest.mark.parametrize(("kilobytes", "shards"), [(200, "none"), (500, "some")])
def test_a_full_disk_is_one_line_and_with_more_room_the_same_command_goes_on(job, whole, tmp_path, kilobytes, shards):
    """A file system that has no room for the plan, or not for all shards; later it has."""
    private = ["unshare", "--mount", "--map-root-user", "bash", "-c"]
    if subprocess.run([*private, "mount -t tmpfs tmpfs /mnt"], capture_output=True).returncode:
        pytest.skip("no file system can be mounted here (unshare --mount --map-root-user)")
    command = [sys.executable, "-m", "simgen.cli", "run", *job]
    ended = subprocess.run(
        [*private, SCRIPT, "bash", str(kilobytes), tmp_path, *command],
        capture_output=True, text=True, env={**os.environ, "COLUMNS": "500"}, timeout=300,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    found = re.search(r"exit code (\d+), shards (\d+), files (\d+)", ended.stdout)
    code, there, files = map(int, found.groups())
    assert code == 2 and "Traceback" not in ended.stdout + ended.stderr
    assert ended.stderr.strip() == "simgen: /mnt/d.zarr: cannot be written: No space left on device"
    if shards == "none":
        assert (there, files) == (0, 0)
        return
    assert 0 < there < SHARDS
    assert fake.contents(tmp_path / "d.zarr") == fake.contents(whole)


def test_a_folder_that_may_not_be_written_is_one_line(job, whole, tmp_path):
    """Neither a new dataset nor one that has to be gone on with; what is there stays."""
    folder = tmp_path / "read_only"
    shutil.copytree(whole, folder / "d.zarr")
    (folder / "d.zarr/manifest/000005.json").unlink()
    before = fake.contents(folder)
    for path in (*folder.rglob("*"), folder):
        path.chmod(path.stat().st_mode & ~0o222)
    try:
        for name in ("new.zarr", "d.zarr"):
            path = folder / name
            ended = simgen("run", *job, "--output", path, *ALONE, preexec_fn=obey_permissions)
            assert one_line(ended) == f"simgen: {path}: cannot be written: Permission denied"
    finally:
        for path in (folder, *folder.rglob("*")):
            path.chmod(path.stat().st_mode | 0o200)
    assert fake.contents(folder) == before


def test_a_whole_dataset_that_may_not_be_written_is_not_written(job, whole, tmp_path):
    shutil.copytree(whole, tmp_path / "d.zarr")
    (tmp_path / "d.zarr").chmod(0o555)
    ended = simgen("run", *job, "--output", tmp_path / "d.zarr", *ALONE, preexec_fn=obey_permissions)
    (tmp_path / "d.zarr").chmod(0o755)
    assert ended.returncode == 0 and f"{SHARDS} of {SHARDS} presses" in ended.stdout
