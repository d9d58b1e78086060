"""Console views: what a user reads of a run, an audit, an export and an import."""

from dataclasses import replace
from types import SimpleNamespace

import fake
import numpy as np
import pytest

from simgen.cli import console
from simgen.dataset.audit_finding import Finding
from simgen.pipeline.parts import ShardReport
from simgen.pipeline.run_status import RunStatus


def printed(capsys) -> str:
    return " ".join(capsys.readouterr().out.split())


def test_a_run_counts_planned_ends_and_samples_inside_out_apart_from_failures():
    bar = console.RunProgress(fake.make_job())
    bar.on_report(ShardReport(0, 2))
    assert bar.failures() == "no samples failed"
    bar.on_report(ShardReport(1, 2, planned=5, inside_out=1))
    bar.on_report(ShardReport(2, 2, failed=3, planned=2))
    assert bar.failures() == "3 samples failed, 1 inverted, 7 not pressed, as planned"


def test_a_shard_that_was_not_written_is_named_and_counted(capsys):
    bar = console.RunProgress(fake.make_job())
    bar.on_report(ShardReport(4, 0, error="no solver [1]"))
    assert printed(capsys) == "shard 4 was not written: no solver [1]"
    assert bar.failures() == "no samples failed, 1 shards not written" and bar.done == 0


def test_an_interrupt_names_the_folder_that_continues(capsys, tmp_path):
    with pytest.raises(SystemExit) as end:
        console.stop("d.zarr")
    assert end.value.code == 130 and printed(capsys) == "stopped; the same command continues from d.zarr"


def test_an_audit_that_fails_names_its_findings(capsys):
    good = Finding("dataset", "presses", "12 of 12", "all", True)
    bad = Finding("digit", "samples converged", "7 of 8", "all", False, note="press 3, depth 1 [stalled]")
    console.print_findings("d.zarr", [good])
    assert "d.zarr passes" in printed(capsys)
    console.print_findings("d.zarr", [good, bad])
    text = printed(capsys)
    assert "d.zarr fails in 1 of 2 points" in text and "digit: press 3, depth 1 [stalled]" in text


def test_a_status_gives_progress_and_time_left(capsys):
    found = RunStatus(12, 3, 0, "process 7 on here", 90.0, 0.25, {2: "no [disk]"})
    console.print_status("d.zarr", found, {"not pressed: no room": 4})
    text = printed(capsys)
    for words in ("d.zarr: 3 of 12 presses, 25.0 %", "running: process 7 on here", "last shard: 1.5 minutes ago; 0.25",
                  "left: about 36 seconds", "4 samples not pressed", "shard 2 was not written: no [disk]"):  # fmt: skip
        assert words in text, words
    console.print_status("d.zarr", replace(found, at_work=None), {})
    text = printed(capsys)
    assert "no process is running; the command that began the run continues it" in text and "left:" not in text


def test_an_export_counts_files_bytes_and_samples(capsys, tmp_path):
    file = tmp_path / "a.npy"
    file.write_bytes(bytes(2_500_000))
    dataset = SimpleNamespace(unfinished=lambda: [1], shards=3)
    selection = SimpleNamespace(paired=np.array([[True, False]]), sensors=("digit", "biotac"), dataset=dataset)
    console.print_export(tmp_path.name, selection, [file, file])
    text = printed(capsys)
    assert "2 files, 5 MB; 1 of 2 samples on digit and biotac" in text
    assert "the run is unfinished: 1 of 3 shards are missing" in text
