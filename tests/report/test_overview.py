"""The head of the page, the audit's verdict and the job."""

import json
import re

import fake
import pytest

from simgen.dataset.reader import Dataset
from simgen.report.overview import audit_section, head, job_section


def test_the_head_counts_samples_and_gives_mean_times(failing):
    text = "".join(head(failing))
    assert "4 trajectories x 3 indenters x 4 depths" in text and "<b>48 samples</b>" in text
    seconds = [line["seconds_by_sensor"]["digit"] for line in failing.timings() if "seconds_by_sensor" in line]
    (mean,) = re.findall(r"Mean time per press: digit ([\d.e-]+) s", text)
    assert float(mean) == pytest.approx(sum(seconds) / failing.presses, rel=5e-3)


def test_a_dataset_without_timings_has_a_head_too(failing, monkeypatch):
    monkeypatch.setattr(Dataset, "timings", lambda self: [])
    assert "Mean time" not in "".join(head(failing))


def test_a_failed_audit_is_open_and_says_what_failed(failing):
    text = "".join(audit_section(failing))
    assert "<span class='fail'>fails</span>" in text and "<details open>" in text
    assert text.count("<span class='fail'>FAIL</span>") >= 1


def test_the_job_is_the_resolved_one(failing):
    text = "".join(job_section(failing)).replace("&quot;", '"')
    shown = json.loads(re.search("<pre>(.*)</pre>", text, re.DOTALL)[1])
    assert shown["job"] == json.loads(json.dumps(failing.job.resolved()))
    counts = [int(each) for each in re.findall(r" (\d+)", text.partition("</p>")[0])]
    assert sum(counts) == len(fake.make_plan(failing.job).arrays["press/trajectory"])
