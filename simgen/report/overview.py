"""Head of the page, verdict of the audit, and the job of the dataset."""

import html
import json
from collections.abc import Iterator

import numpy as np

from simgen.dataset.audit import check, passes
from simgen.dataset.reader import Dataset
from simgen.dataset.splits import SPLITS
from simgen.plotting.html import folded, table


def head(dataset: Dataset) -> Iterator[str]:
    job, code = dataset.job, dataset.attributes.get("code", {})
    commit = (code.get("commit") or "")[:12] or "installed package"
    yield f"<h1>{html.escape(job.name)}</h1>"
    yield (
        f"<p>{job.trajectories.count:,} trajectories x {job.indenters_in_words} x "
        f"{job.steps_in_words} = "
        f"<b>{job.samples:,} samples</b>, each on {' and '.join(dataset.sensors)}. Job {job.hash[:12]}, "
        f"simgen {code.get('version', '')} ({commit}{', with changes' if code.get('dirty') else ''})."
        f"{_seconds(dataset)}</p>"
    )


def _seconds(dataset: Dataset) -> str:
    """Mean seconds per press on each sensor, from the timings of the tasks."""
    entries = [line for line in dataset.timings() if line.get("seconds_by_sensor")]
    presses = sum(entry["presses"] for entry in entries)
    if not presses:
        return ""
    means = (
        f"{sensor} {sum(entry['seconds_by_sensor'][sensor] for entry in entries) / presses:.3g} s"
        for sensor in dataset.sensors
    )
    return f" Mean time per press: {', '.join(means)}."


def audit_section(dataset: Dataset) -> Iterator[str]:
    findings = check(dataset)
    verdict = "<span class='ok'>passes</span>" if passes(findings) else "<span class='fail'>fails</span>"
    yield f"<p>The dataset {verdict} its audit.</p>"
    rows = []
    for finding in findings:
        mark = "<span class='fail'>FAIL</span>" if finding.failed else "" if finding.passed is None else "ok"
        rows.append([finding.subject, finding.what, finding.found, finding.allowed, mark])
    for finding in findings:
        for line in finding.note.splitlines():
            yield f"<p>{html.escape(f'{finding.subject}: {line}')}</p>"
    lines = [table(["", "", "found", "allowed", ""], rows, raw_last=True)]
    yield folded(f"{len(rows)} findings", lines, opened=not passes(findings))


def job_section(dataset: Dataset) -> Iterator[str]:
    split = dataset["press/split"]
    counts = ", ".join(f"{name} {np.count_nonzero(split == code)}" for code, name in enumerate(SPLITS))
    yield f"<p>Presses by split: {counts}.</p>"
    shown = {key: dataset.attributes.get(key) for key in ("job", "sensors", "packages", "device")}
    yield folded("Job, sensors and packages", [f"<pre>{html.escape(json.dumps(shown, indent=2))}</pre>"])
