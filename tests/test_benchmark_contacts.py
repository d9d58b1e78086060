"""The benchmark of training contacts trains the networks of the job."""

import importlib
import json
import sys

import numpy as np
import pytest
from pages import ROOT

pytest.importorskip("torch")


@pytest.fixture
def contacts(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    monkeypatch.chdir(tmp_path)
    return importlib.import_module("contacts")


@pytest.fixture
def comparison(contacts, trained, with_electrodes):
    return contacts.Comparison(trained.output, with_electrodes.path, 2, "cpu")


@pytest.mark.parametrize("name", ["s2rm", "rm2rm"])
def test_networks_are_those_of_the_job(comparison, trained, tmp_path, name):
    """With the circuit and the mirror images of its S2RM."""
    found = comparison.train(name, comparison.of_first(10), None, tmp_path)
    assert found.settings() == trained.trained(name).settings()
    assert found.mirrored == (name == "s2rm") == (found.circuit is not None)


def test_an_indenter_that_is_left_out_is_tested_and_not_trained(comparison):
    data = comparison.data
    comparison.job = comparison.job.model_copy(update={"leave_out": "ring_7mm"})
    ring = data.dataset.indenters.index("ring_7mm")
    for rows in comparison.of_first(10):
        assert len(rows) and ring not in data.indenter[rows] and data.trajectory[rows].max() < 10
    assert ring in data.indenter[comparison.tested]


def test_rows_have_the_errors_of_each_number_of_contacts(contacts, trained, with_electrodes, monkeypatch, tmp_path):
    given = [str(trained.output), str(with_electrodes.path), "--tested", "2", "--contacts", "6", "10"]
    monkeypatch.setattr(sys, "argv", ["contacts.py", *given, "--output", "found.json"])
    contacts.main()
    rows = json.loads((tmp_path / "found.json").read_text())["rows"]
    assert [row["contacts"] for row in rows] == ["as trained", 6, 10] and rows[1]["samples"] < rows[2]["samples"]
    assert all(np.isfinite(row[given]["rmse_um"]) for row in rows for given in ("signals", "source"))
