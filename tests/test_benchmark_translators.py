"""The benchmark of translators: networks that others made, from files and from functions."""

import importlib
import json
import sys

import numpy as np
import pytest
import zarr
from pages import ROOT

pytest.importorskip("torch")
INPUTS = {"press", "step", "signals", "source"}


@pytest.fixture
def compare(trained, with_electrodes, tmp_path, monkeypatch):
    """Runs the benchmark in an empty folder with arguments, and returns its record."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    monkeypatch.chdir(tmp_path)
    main = importlib.import_module("translators").main

    def run(*arguments: str) -> dict:
        given = [str(with_electrodes.path), str(trained.output), *arguments, "--output", "found.json"]
        monkeypatch.setattr(sys, "argv", ["translators.py", *given])
        main()
        return json.loads((tmp_path / "found.json").read_text()) if "--list" not in arguments else {}

    return run


@pytest.fixture
def listed(compare, tmp_path):
    """The test samples, and the true meshes of the target."""
    compare("--list", "test.npz")
    with np.load(tmp_path / "test.npz") as stored:
        return dict(stored)


def truth(dataset, samples) -> np.ndarray:
    pairs = zip(samples["press"], samples["step"], strict=True)
    return np.stack([dataset.displacement("digit", int(press), int(step)) for press, step in pairs])


def figures(found: dict) -> dict[str, dict]:
    return {row["model"]: row["all"] for row in found["rows"]}


def test_the_list_has_the_inputs_of_the_test_samples(listed, with_electrodes, trained):
    rows = trained.inputs.data.rows("test")
    assert listed.keys() == INPUTS
    np.testing.assert_array_equal(listed["press"], trained.inputs.data.press[rows])
    np.testing.assert_array_equal(listed["signals"], trained.inputs.signals.values[rows])
    np.testing.assert_array_equal(listed["source"], trained.inputs.source.displacement(rows))
    assert (with_electrodes["press/split"][listed["press"]] == 2).all()


@pytest.mark.parametrize("inputs", ["source", "signals"])
def test_predictions_stand_beside_ours(compare, listed, with_electrodes, inputs, capsys):
    """The truth in another order, with a sample that nobody asks for; and half of it in a zarr folder."""
    true = truth(with_electrodes, listed)
    order = np.random.default_rng(0).permutation(len(true))
    more = {"press": np.append(listed["press"][order], 0), "step": np.append(listed["step"][order], 0)}
    np.savez("truth.npz", **more, displacement=np.concatenate([true[order], true[:1]]))
    folder = zarr.open_group("half.zarr", mode="w")
    for key, values in {"press": listed["press"], "step": listed["step"], "displacement": 0.5 * true}.items():
        folder[key] = values
    found = compare("--inputs", inputs, "--predictions", "all=truth.npz", "--predictions", "half=half.zarr")
    own = figures(found)
    assert list(own)[-2:] == ["all", "half"] and {"rest", "floor"} < own.keys()
    assert own["all"]["rmse_um"]["mean"] == pytest.approx(0.0, abs=1e-4)
    assert own["all"]["near"] == {"mean": 1.0, "std": 0.0, "samples": len(true)}
    assert own["half"]["rmse_um"]["mean"] == pytest.approx(own["rest"]["rmse_um"]["mean"] / 2, rel=1e-5)
    assert found["task"] == {"source": "biotac mesh", "signals": "electrode signals"}[inputs] + " -> digit mesh"
    assert "| half |" in capsys.readouterr().out


def test_ours_are_those_of_the_table(compare, trained):
    from simgen.learning.training.evaluate import evaluate

    evaluate(trained, lambda items, about: items)
    (expected,) = [own for task, own in json.loads((trained.output / "metrics.json").read_text())["tasks"].items()
                   if task == "biotac mesh -> digit mesh"]  # fmt: skip
    assert compare()["rows"] == expected


def test_a_function_gets_the_inputs_and_is_measured(compare, monkeypatch, tmp_path):
    (tmp_path / "theirs.py").write_text(
        "import numpy, torch\n"
        f"def rest(given):\n    assert given.keys() == {INPUTS}\n    return torch.zeros(len(given['press']), 642, 3)\n"
        "def array(given):\n    return numpy.zeros((len(given['step']), 642, 3))\n"
    )
    own = figures(compare("--network", "tensor=theirs:rest", "--network", "array=theirs:array"))
    assert own["tensor"] == own["array"] == own["rest"]


def arrays(**changes):
    plain = {"press": np.arange(3), "step": np.arange(3), "displacement": np.zeros((3, 642, 3))} | changes
    return {key: values for key, values in plain.items() if values is not None}


@pytest.mark.parametrize(
    ("stored", "words"),
    [
        (arrays(), "a.npz: 10 of 10 test samples are missing, the first is press"),
        (arrays(press=None), "a.npz: cannot be read"),
        (arrays(step=np.arange(2)), "a.npz: step: int64 (2,); allowed: a whole number for each sample"),
        (arrays(press=np.zeros(3)), "a.npz: press: float64 (3,); allowed: a whole number"),
        (arrays(displacement=np.zeros((3, 5, 3))), "a.npz: displacement has shape (3, 5, 3); allowed: (3, 642, 3)"),
        (arrays(displacement=np.zeros((3, 642, 3), int)), "a.npz: displacement: int64; allowed: floating-point"),
    ],
)
def test_a_file_that_does_not_fit_is_one_line(compare, capsys, stored, words):
    np.savez("a.npz", **stored)
    assert_refused(compare, capsys, words, "--predictions", "a=a.npz")


def test_a_sample_that_is_there_twice_is_one_line(compare, listed, capsys):
    both = {key: np.append(listed[key], listed[key][:1]) for key in ("press", "step")}
    np.savez("a.npz", **both, displacement=np.zeros((len(both["press"]), 642, 3)))
    assert_refused(compare, capsys, "a.npz: samples are there twice", "--predictions", "a=a.npz")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--predictions", "a=no.npz"], "no.npz: cannot be read"),
        (["--predictions", "a=."], ".: cannot be read"),
        (["--network", "a=missing_module:f"], "--network missing_module:f: No module named"),
        (["--network", "a=math:f"], "--network math:f: module 'math' has no attribute 'f'; allowed: module:function"),
        (["--network", "a=builtins:len"], "builtins:len: returned int; allowed: a tensor or an array"),
        (["--network", "a=math:f", "--predictions", "a=b"], "--predictions and --network: a, a; allowed: each name"),
    ],
)
def test_arguments_that_do_not_fit_are_one_line(compare, capsys, arguments, words):
    assert_refused(compare, capsys, words, *arguments)


def assert_refused(compare, capsys, words: str, *arguments: str) -> None:
    capsys.readouterr()
    with pytest.raises(SystemExit, match="2"):
        compare(*arguments)
    said = capsys.readouterr().err
    assert words in said and said.count("\n") == 1
