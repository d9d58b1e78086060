"""Figures of a sitting that its steps wrote, rounded to five digits."""

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

GROUPS = ("by_indenter", "by_depth_mm")
IN_GROUPS = ("rmse_um", "rmse", "near", "covered", "energy_um", "contact_overlap")  # `metrics.json` has all others
ABOUT = ("epochs", "best_epoch", "seconds", "samples_per_second", "parameters", "sha256")


def figures(folder: Path) -> dict[str, Any]:
    """Collect the figures of the steps that have ended.

    A step that has failed leaves the files of an earlier command, if there was one.

    Returns ``samples``, the number of valid ones, and ``networks``, both by folder; ``errors`` by folder, task and
    model; ``edges`` by step and indenter; and ``translated`` by indenter, the contacts of the samples with images.
    """
    begun = [path.parent for path in sorted(folder.glob("*.networks/training.json"))]
    trained = {path.name.removesuffix(".networks"): path for path in begun}
    tables = {name: path / "metrics.json" for name, path in trained.items()}
    edges = {path.stem.removeprefix("edges_"): _read(path) for path in sorted(folder.glob("edges_*.json"))}
    contacts = folder / "translated" / "contact.json"
    return {
        "samples": {name: _read(path / "training.json")["dataset"]["samples"] for name, path in trained.items()},
        "networks": {name: _networks(path) for name, path in trained.items()},
        "errors": {name: _errors(_read(path)["tasks"]) for name, path in tables.items() if path.exists()},
        "edges": {step: {row.pop("indenter"): _rounded(row) for row in found["rows"]} for step, found in edges.items()},
        "translated": _rounded(_read(contacts)["groups"]) if contacts.exists() else {},
    }


def _networks(folder: Path) -> dict[str, Any]:
    """Say how each network of a folder was trained, with the terms of its best and of its last epoch."""
    found = {}
    for path in sorted(folder.glob("*/network.json")):
        about = _read(path)
        found[path.parent.name] = _rounded({name: about[name] for name in ABOUT} | {"best": about["best"]})
        found[path.parent.name]["last"] = _rounded(_last_epoch(path.with_name("epochs.csv")))
    return found


def _last_epoch(log: Path) -> dict[str, float]:
    with log.open(newline="", encoding="utf-8") as file:
        *_, last = csv.DictReader(file)
    return {name: float(value) for name, value in last.items() if name.startswith(("train_", "validation_"))}


def _errors(tasks: Mapping[str, list[Mapping[str, Any]]]) -> dict[str, dict[str, Any]]:
    """Take the means of each model over all test samples, and over those of an indenter and of a depth."""
    return {task: {entry["model"]: _of_model(entry) for entry in entries} for task, entries in tasks.items()}


def _of_model(entry: Mapping[str, Any]) -> dict[str, Any]:
    samples = next((measure["samples"] for measure in entry["all"].values() if measure), 0)
    found = {"parameters": entry["parameters"], "samples": samples, "best_baseline": entry["bar"], **_means(entry)}
    if entry["answers"]:
        found["answers"] = _means(entry["answers"])
    return found


def _means(groups: Mapping[str, Any]) -> dict[str, Any]:
    """Take the mean of each measure in ``all``, and of those `IN_GROUPS` in each group of `GROUPS`."""

    def of(measures: Mapping[str, Any]) -> dict[str, Any]:
        return {name: value and _rounded(value["mean"]) for name, value in measures.items()}

    def of_group(group: Mapping[str, Any]) -> dict[str, Any]:
        return {key: of({name: own[name] for name in IN_GROUPS if name in own}) for key, own in group.items()}

    return {"all": of(groups["all"])} | {name: of_group(groups[name]) for name in GROUPS if name in groups}


def _rounded(value: Any) -> Any:
    """Round the numbers of a value, or of all values of a dict."""
    if isinstance(value, dict):
        return {name: _rounded(each) for name, each in value.items()}
    return float(f"{value:.5g}") if isinstance(value, float) else value


def _read(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))
