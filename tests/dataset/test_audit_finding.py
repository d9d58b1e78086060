"""Findings: limits, the samples that they name, and their JSON."""

import json

import numpy as np

from simgen.dataset.audit_finding import SHOWN, as_json, name, named, not_looked_at


def test_values_above_the_limit_and_values_that_are_no_numbers_fail():
    values = np.array([[1.0, 2.0], [3.0, np.nan]])
    found = named("digit", "residual", values, 2.0, "{:.1f} um")
    assert found.failed and found.bad == ((1, 0), (1, 1))
    assert found.allowed == "<= 2 um" and found.note == "residual: press 1, depth 0; press 1, depth 1"


def test_samples_outside_the_mask_do_not_count():
    values = np.array([[1.0, 9.0]])
    found = named("digit", "residual", values, 2.0, "{:.1f}", of=np.array([[True, False]]))
    assert found.passed and found.found == "1.0" and found.bad == ()
    assert named("digit", "gaps", values, 0.0, "{:.0f}", total=True).found == "10"
    assert named("digit", "residual", values, 2.0, "{:.1f}", of=np.zeros((1, 2), bool)).found == "0.0"


def test_bad_presses_are_named_but_not_solved_again():
    found = named("digit", "contact distance", np.array([0.0, 60.0]), 50.0, "{:.0f} um")
    assert found.failed and found.bad == () and found.note == "contact distance: press 1"


def test_a_note_names_some_and_counts_the_others():
    assert name("gaps", ()) == ""
    assert name("gaps", tuple((press,) for press in range(SHOWN + 2))).endswith(f"press {SHOWN - 1}; and 2 more")


def test_json_has_every_bad_sample():
    values = np.full((SHOWN + 3, 1), 5.0)
    findings = [named("digit", "residual", values, 1.0, "{:g}"), not_looked_at("digit", "contacts", "imported")]
    first, second = json.loads(as_json(findings))
    assert first["bad"] == [[press, 0] for press in range(SHOWN + 3)]
    assert second["passed"] is None and second["note"] == "contacts: imported" and not findings[1].failed
