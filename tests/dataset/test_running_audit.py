"""An audit while a run goes on: it looks at complete shards alone, and finds what an audit after the run finds."""

import shutil
import threading

import fake
import numpy as np
import pytest

from simgen.dataset import running_audit
from simgen.dataset.audit import ComparedFiles, check
from simgen.dataset.chunk_files import chunk_path
from simgen.dataset.reader import Dataset
from simgen.dataset.running_audit import RunningAudit
from simgen.dataset.touch_audit import DisplacementCheck
from simgen.pipeline.run import run


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return run(fake.make_plan(fake.make_job()), tmp_path_factory.mktemp("whole") / "d.zarr", build=fake.fake_presser)


def spoil_displacement(dataset: Dataset, shard: int, monkeypatch):
    """Let the shard's held vertices move by 1 mm, without a change of its files."""
    read = Dataset.stored_displacement

    def moved(self, sensor, press, depth=slice(None)):
        stored = read(self, sensor, press, depth)
        if press.start == dataset.shard_presses(shard).start and sensor == "biotac":
            stored = np.where(fake.HELD[:, None], 9999, stored)
        return stored

    monkeypatch.setattr(Dataset, "stored_displacement", moved)


@pytest.mark.parametrize("looked_at", [range(6), [4], []])
def test_it_finds_what_an_audit_after_the_run_finds(whole, monkeypatch, looked_at):
    """However many shards it has looked at: it looks at the others at the end."""
    spoil_displacement(whole, 4, monkeypatch)
    audit = RunningAudit(whole.path)
    for shard in looked_at:
        audit.look_at(shard)
    found = audit.findings()
    assert [finding.what for finding in found if finding.failed] == ["held vertices move"]
    assert found == check(whole)


def test_a_shard_is_looked_at_once(whole, monkeypatch):
    seen, look = [], DisplacementCheck.shard
    monkeypatch.setattr(DisplacementCheck, "shard", lambda self, shard: seen.append(shard) or look(self, shard))
    audit = RunningAudit(whole.path)
    audit.look_at(2).result()
    assert seen == [2, 2]  # on two sensors
    audit.findings()
    assert sorted(seen) == sorted(2 * [0, 1, 2, 3, 4, 5])


def test_a_file_that_changes_before_is_found(whole, tmp_path):
    spoiled = Dataset(shutil.copytree(whole.path, tmp_path / "d.zarr"))
    file = sorted((spoiled.path / "digit/force/c").rglob("*"))[-1]
    file.write_bytes(file.read_bytes()[:-1] + b"x")
    audit = RunningAudit(spoiled.path)
    for shard in range(6):
        audit.look_at(shard)
    found = audit.findings()
    [sums] = [finding for finding in found if finding.what == "checksums"]
    assert sums.failed and file.relative_to(spoiled.path).as_posix() in sums.note
    assert found == check(spoiled)


def test_shards_are_looked_at_as_they_are_written(tmp_path):
    """Before the run ends, while other shards are not there yet."""
    path, seen = tmp_path / "d.zarr", []
    audit = RunningAudit(path)

    def on_report(report):
        audit.look_at(report.shard).result()
        seen.append(len(Dataset(path).finished()))

    dataset = run(fake.make_plan(fake.make_job()), path, on_report=on_report, build=fake.fake_presser)
    assert seen == [1, 2, 3, 4, 5, 6]
    assert audit.findings() == check(dataset)


@pytest.mark.parametrize("name", ["press/pose", "digit/touch", "biotac/displacement", "biotac/status"])
def test_an_old_shard_with_a_bad_file_hides_nothing_in_new_ones(whole, tmp_path, monkeypatch, name):
    """As when a run goes on: the old shard is not looked at during the run."""
    spoil_displacement(whole, 4, monkeypatch)
    dataset = Dataset(shutil.copytree(whole.path, tmp_path / "d.zarr"))
    file = dataset.path / chunk_path(name, 0, dataset.array(name).ndim)
    file.write_bytes(file.read_bytes()[:-1])
    audit = RunningAudit(dataset.path)
    for shard in range(1, 6):
        audit.look_at(shard)
    found = audit.findings()
    assert {"checksums", "held vertices move"} <= {finding.what for finding in found if finding.failed}
    assert found == check(dataset)


@pytest.mark.parametrize("file", ["digit/held/c/0", "manifest/plan.json"])
def test_a_plan_that_is_damaged_is_a_finding(whole, tmp_path, file):
    dataset = Dataset(shutil.copytree(whole.path, tmp_path / "d.zarr"))
    (dataset.path / file).write_bytes((dataset.path / file).read_bytes()[:-9])
    audit = RunningAudit(dataset.path)
    for shard in range(6):
        audit.look_at(shard)
    found = audit.findings()
    assert "checksums" in {finding.what for finding in found if finding.failed}
    assert found == check(dataset)


def test_a_run_that_fails_does_not_wait_for_shards_to_look_at(whole, monkeypatch):
    began, end, seen = threading.Event(), threading.Event(), []

    def slow(dataset, manifest):
        seen.append(manifest)
        began.set()
        end.wait(60)
        return ComparedFiles(1, [manifest])

    monkeypatch.setattr(running_audit, "compare_files", slow)
    monkeypatch.setattr(running_audit, "AT_ONCE", 1)
    with pytest.raises(KeyboardInterrupt), RunningAudit(whole.path) as audit:
        for shard in range(6):
            audit.look_at(shard)
        assert began.wait(60)
        threading.Timer(0.2, end.set).start()
        raise KeyboardInterrupt
    assert seen == ["000000.json"]
