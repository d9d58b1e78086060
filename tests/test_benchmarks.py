"""Benchmarks: each can be imported, and the record of a run names its arguments, code and machine."""

import importlib
import json

import pytest
from pages import ROOT

VERBS = {"Compare", "Count", "Draw", "Find", "Measure", "Time"}
BENCHMARKS = sorted(path.stem for path in (ROOT / "benchmarks").glob("*.py"))


@pytest.fixture(autouse=True)
def benchmarks_first(monkeypatch):
    """Benchmarks import each other by name."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")


@pytest.mark.parametrize("name", BENCHMARKS)
def test_a_benchmark_is_imported_and_says_what_it_measures(name):
    if name in ("contacts", "mesh_vae", "one_sitting", "signal_limit", "translated_edges", "translators", "twins"):
        pytest.importorskip("torch")
    if name == "mesh_vae":
        pytest.importorskip("torch_geometric")
    module = importlib.import_module(name)
    assert module.__file__ == str(ROOT / "benchmarks" / f"{name}.py")
    title = module.__doc__.splitlines()[0]
    assert title.endswith(".") and (not hasattr(module, "main") or title.split()[0] in VERBS)


def test_a_record_has_arguments_rows_and_origin(tmp_path):
    record = importlib.import_module("record")
    parser = record.sensor_arguments("Measure nothing.\n\nMore.", "nothing.json")
    asked = parser.parse_args(["--mesh", "fine", "--output", str(tmp_path / "r.json")])
    record.write(asked, [{"seconds": 1.0}], unknowns=7)
    stored = json.loads((tmp_path / "r.json").read_text())
    assert stored["question"] == "Measure nothing." and stored["rows"] == [{"seconds": 1.0}] and stored["unknowns"] == 7
    assert stored["asked"] == {"device": "cpu", "sensor": "digit", "mesh": "fine"}
    assert stored["machine"]["device"] == "cpu" and len(stored["code"]["source"]) == 64


def test_the_phases_that_are_timed_exist():
    phases = importlib.import_module("rounds").PHASES
    assert not [(owner, name) for owner, names in phases.items() for name in names if not hasattr(owner, name)]
