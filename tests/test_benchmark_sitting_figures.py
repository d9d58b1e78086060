"""Figures of a sitting are those of the files that its steps wrote."""

import csv
import importlib
import json
import shutil

import pytest
from pages import ROOT

pytest.importorskip("torch")


IN_GROUPS = {"rmse_um", "rmse", "near", "covered", "energy_um", "contact_overlap"}


def means(measures: dict, names):
    """Means of measures, which figures may differ from by rounding; None stays None."""
    return pytest.approx(
        {name: measures[name] and measures[name]["mean"] for name in names}, rel=1e-4, nan_ok=True
    )


@pytest.fixture
def figures(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    return importlib.import_module("sitting_figures").figures


def test_errors_and_answers_are_those_of_the_tables(figures, trained, tmp_path):
    from simgen.learning.training.evaluate import evaluate

    evaluate(trained, lambda items, about: items)
    (tmp_path / "ours.networks").symlink_to(trained.output)
    found = figures(tmp_path)["errors"]["ours"]
    tasks = json.loads((trained.output / "metrics.json").read_text())["tasks"]
    assert found.keys() == tasks.keys()
    for task, entries in tasks.items():
        assert list(found[task]) == [entry["model"] for entry in entries]
        for entry in entries:
            own = found[task][entry["model"]]
            assert own["all"] == means(entry["all"], entry["all"])
            assert (own["parameters"], own["best_baseline"]) == (entry["parameters"], entry["bar"])
            assert own["samples"] == entry["all"]["rmse_um" if "rmse_um" in entry["all"] else "rmse"]["samples"]
            for group in ("by_indenter", "by_depth_mm"):
                assert own.get(group, {}).keys() == entry.get(group, {}).keys()
                for name, measures in entry.get(group, {}).items():
                    assert own[group][name] == means(measures, IN_GROUPS & measures.keys())
            if entry["answers"]:
                drawn = entry["answers"]
                assert own["answers"]["all"] == means(drawn["all"], drawn["all"])
                for name, measures in drawn["by_indenter"].items():
                    assert own["answers"]["by_indenter"][name] == means(measures, IN_GROUPS & measures.keys())
    assert any("answers" in own for models in found.values() for own in models.values())


def test_a_folder_without_tables_has_its_networks(figures, trained, tmp_path):
    """A step may still train the others."""
    shutil.copytree(trained.output / "rmb", tmp_path / "paper.networks" / "rmb")
    shutil.copy(trained.output / "training.json", tmp_path / "paper.networks")
    (tmp_path / "ours.networks").mkdir()  # its training was refused
    found = figures(tmp_path)
    about = json.loads((trained.output / "rmb" / "network.json").read_text())
    assert found["errors"] == {} and list(found["networks"]["paper"]) == ["rmb"]
    assert found["samples"] == {"paper": len(trained.inputs.data)}
    rmb = found["networks"]["paper"]["rmb"]
    assert rmb["best_epoch"] == about["best_epoch"] and rmb["best"] == pytest.approx(about["best"], rel=1e-3)
    *_, last = csv.DictReader((trained.output / "rmb" / "epochs.csv").open(newline=""))
    assert rmb["last"] == pytest.approx({name: float(last[name]) for name in about["best"]}, rel=1e-3)


def test_edges_and_contacts_are_those_of_each_indenter(figures, tmp_path):
    (tmp_path / "translated").mkdir()
    contacts = {"way": "points", "groups": {"cube_14mm": {"samples": 3, "near": 0.666666}}}
    (tmp_path / "translated" / "contact.json").write_text(json.dumps(contacts))
    rows = [{"indenter": "cube_14mm", "images": 3, "ratio_of_sums": 0.987654}, {"indenter": "all", "images": 3}]
    (tmp_path / "edges_points.json").write_text(json.dumps({"rows": rows}))
    found = figures(tmp_path)
    assert found["translated"] == {"cube_14mm": {"samples": 3, "near": 0.66667}}
    assert found["edges"] == {
        "points": {"cube_14mm": {"images": 3, "ratio_of_sums": 0.98765}, "all": {"images": 3}}
    }
