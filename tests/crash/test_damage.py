"""Two runs at once, another job, files that rot: refused or named in one line, and repaired to the same bytes."""

import shutil
import signal
import time

import fake

from tests.crash.conftest import JOB, SHARDS, simgen, start
from tests.crash.test_disk import one_line


def test_a_second_run_into_the_same_dataset_is_refused_and_the_first_is_not_disturbed(whole, tmp_path):
    path = tmp_path / "d.zarr"
    first = start("run", *JOB, "--output", path, "--workers", "1")
    while not any(path.glob("manifest/0*.json")):
        assert first.poll() is None
        time.sleep(0.02)
    first.send_signal(signal.SIGSTOP)  # or it might end before the second one has begun
    second = simgen("run", *JOB, "--output", path, "--scheduler", "sync")
    first.send_signal(signal.SIGCONT)
    output, errors = first.communicate(timeout=120)
    assert first.returncode == 0, output + errors
    assert fake.contents(path) == fake.contents(whole)
    assert f"{path}: process {first.pid} on " in one_line(second) and "is writing into it" in second.stderr


def test_two_runs_that_begin_together_leave_one_dataset(whole, tmp_path):
    path = tmp_path / "d.zarr"
    runs = [start("run", *JOB, "--output", path, "--scheduler", "sync") for _ in range(2)]
    said = [run.communicate(timeout=240) for run in runs]
    codes = sorted(run.returncode for run in runs)
    assert codes in ([0, 2], [0, 0]), said  # the second may have come when the first had just ended
    assert fake.contents(path) == fake.contents(whole)
    assert [entry.name for entry in tmp_path.iterdir()] == ["d.zarr"]


def test_another_job_is_refused_with_the_difference(whole, tmp_path):
    before, path = fake.contents(whole), tmp_path / "d.zarr"
    shutil.copytree(whole, path)
    ended = simgen("run", *JOB, "solver.friction_stiffness=30", "--output", path, "--scheduler", "sync")
    assert "holds another dataset (job.solver.friction_stiffness: 20.0 -> 30.0)" in one_line(ended)
    assert fake.contents(path) == before


def test_rotten_files_are_named_and_repaired(whole, tmp_path):
    """One byte of a shard, a whole file, half a manifest; and what cannot be repaired is said to be so."""
    path = tmp_path / "d.zarr"
    shutil.copytree(whole, path)
    displacement, manifest = path / "digit/displacement/c/4/0/0/0", path / "manifest/000009.json"
    rotten = bytearray(displacement.read_bytes())
    rotten[len(rotten) // 2] ^= 1
    displacement.write_bytes(rotten)
    (path / "digit/touch/c/2").unlink()
    manifest.write_bytes(manifest.read_bytes()[:100])
    found = simgen("check", path)
    assert found.returncode == 1 and "Traceback" not in found.stderr
    for file in (displacement, path / "digit/touch/c/2", manifest):
        assert str(file.relative_to(path)) in found.stdout
    repaired = simgen("check", path, "--repair", "--scheduler", "sync")
    assert repaired.returncode == 0 and f"{SHARDS} of {SHARDS} presses" in repaired.stdout, repaired.stderr
    assert fake.contents(path) == fake.contents(whole)

    (path / "digit/rest_positions/c/0/0").write_bytes(b"")
    ended = simgen("check", path, "--repair")
    assert "digit/rest_positions/c/0/0" in ended.stdout
    assert f"{path}: its plan, which all presses share, has changed" in one_line(ended)
