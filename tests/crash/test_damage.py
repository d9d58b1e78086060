"""Two runs at once, another job, files that rot: refused or named in one line, and repaired to the same bytes."""

import shutil
import signal
import time

import fake
import pytest
from refusal import check_refusal, simgen

from simgen.cli.console import console
from tests.crash.conftest import SHARDS, start


@pytest.fixture
def command(monkeypatch, capfd):
    """The command line in this process: exit code, output, errors. No message is broken into lines."""
    monkeypatch.setattr(console, "width", 500)
    return lambda *arguments: simgen([*map(str, arguments)], monkeypatch, capfd)


def test_a_second_run_into_the_same_dataset_is_refused_and_the_first_is_not_disturbed(job, whole, tmp_path, command):
    path = tmp_path / "d.zarr"
    first = start("run", *job, "--output", path, "--scheduler", "sync")
    while not any(path.glob("manifest/0*.json")):
        assert first.poll() is None
        time.sleep(0.02)
    first.send_signal(signal.SIGSTOP)  # or it might end before the second one has begun
    code, output, errors = command("run", *job, "--output", path, "--scheduler", "sync")
    first.send_signal(signal.SIGCONT)
    said = first.communicate(timeout=120)
    assert first.returncode == 0, said
    assert fake.contents(path) == fake.contents(whole)
    check_refusal(code, output, errors, f"{path}: process {first.pid} on ")
    assert "is writing into it" in errors


def test_two_runs_that_begin_together_leave_one_dataset(job, whole, tmp_path):
    path = tmp_path / "d.zarr"
    runs = [start("run", *job, "--output", path, "--scheduler", "sync") for _ in range(2)]
    said = [run.communicate(timeout=240) for run in runs]
    codes = sorted(run.returncode for run in runs)
    assert codes in ([0, 2], [0, 0]), said  # the second may have come when the first had just ended
    assert fake.contents(path) == fake.contents(whole)
    assert [entry.name for entry in tmp_path.iterdir()] == ["d.zarr"]


def test_another_job_is_refused_with_the_difference(job, whole, tmp_path, command):
    before, path = fake.contents(whole), tmp_path / "d.zarr"
    shutil.copytree(whole, path)
    ended = command("run", *job, "solver.friction_stiffness=30", "--output", path, "--scheduler", "sync")
    check_refusal(*ended, "holds another dataset (job.solver.friction_stiffness: 4.0 -> 30.0)")
    assert fake.contents(path) == before


def test_rotten_files_are_named_and_repaired(whole, tmp_path, command):
    """One byte of a shard, a whole file, half a manifest; and what cannot be repaired is said to be so."""
    path = tmp_path / "d.zarr"
    shutil.copytree(whole, path)
    displacement, manifest = path / "slab/displacement/c/4/0/0/0", path / "manifest/000006.json"
    rotten = bytearray(displacement.read_bytes())
    rotten[len(rotten) // 2] ^= 1
    displacement.write_bytes(rotten)
    (path / "slab/touch/c/2").unlink()
    manifest.write_bytes(manifest.read_bytes()[:100])
    code, output, errors = command("check", path)
    assert code == 1 and "Traceback" not in errors
    for file in (displacement, path / "slab/touch/c/2", manifest):
        assert str(file.relative_to(path)) in output
    code, output, errors = command("check", path, "--repair", "--scheduler", "sync")
    assert code == 0 and f"{SHARDS} of {SHARDS} presses" in output, output + errors
    assert fake.contents(path) == fake.contents(whole)

    (path / "slab/rest_positions/c/0/0").write_bytes(b"")
    code, output, errors = command("check", path, "--repair")
    assert "slab/rest_positions/c/0/0" in output
    check_refusal(code, output, errors, f"{path}: its plan, which all presses share, has changed")
