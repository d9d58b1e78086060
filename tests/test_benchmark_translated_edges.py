"""The benchmark of edges: energies that are known by hand, and its rows."""

import importlib
import json
import sys

import numpy as np
import pytest
from pages import ROOT

pytest.importorskip("torch")


@pytest.fixture
def edges(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    monkeypatch.chdir(tmp_path)
    return importlib.import_module("translated_edges")


def test_energy_is_that_of_differences_from_the_untouched_gel(edges):
    """A pixel that is 3 brighter in one channel has four edges; at a corner it has two."""
    untouched = np.random.default_rng(0).integers(0, 200, (5, 4, 3)).astype(np.uint8)
    images = np.stack([untouched] * 3)
    images[1, 2, 1, 0] += 3
    images[2, 0, 0, 2] += 3
    np.testing.assert_array_equal(edges.gradient_energy(images, untouched.astype(np.float64)), [0.0, 36.0, 18.0])


def test_a_row_counts_untouched_images_and_leaves_them_out(edges):
    found = edges.row("cube", np.array([[1.0, 5.0, 3.0, 4.0], [2.0, 0.0, 3.0, 5.0]]))
    assert found == {"indenter": "cube", "images": 4, "untouched": 1, "ratio_of_sums": 0.8, "median_ratio": 0.8,
                     "as_true": pytest.approx(1 / 3)}  # fmt: skip
    nothing = edges.row("cube", np.array([[1.0], [0.0]]))
    assert nothing["untouched"] == 1
    assert [nothing[key] for key in ("ratio_of_sums", "median_ratio", "as_true")] == [None, None, None]


@pytest.fixture
def run(edges, with_electrodes, trained, monkeypatch, tmp_path):
    """Runs the benchmark on a dataset and networks with arguments, and returns its record."""

    def run(*arguments: str, dataset=None) -> dict:
        given = [str(trained.output), str(dataset or with_electrodes.path), *arguments, "--output", "found.json"]
        monkeypatch.setattr(sys, "argv", ["translated_edges.py", *given])
        edges.main()
        return json.loads((tmp_path / "found.json").read_text())

    return run


def test_rows_are_those_of_indenters_and_of_all(run, with_electrodes):
    *own, both = run("--presses", "1", "--depths", "2", "--height", "40")["rows"]
    assert [row["indenter"] for row in own] == list(with_electrodes.indenters) and both["indenter"] == "all"
    assert both["images"] == sum(row["images"] for row in own) == 2 * len(own)


def test_true_meshes_of_the_source_take_the_place_of_signals(run):
    from_signals, from_meshes = (run("--presses", "1", "--depths", "2", "--height", "40", *more)["rows"]
                                 for more in ((), ("--true-meshes",)))  # fmt: skip
    assert [row["images"] for row in from_meshes] == [row["images"] for row in from_signals]
    assert from_meshes != from_signals


def test_a_dataset_without_test_presses_is_one_line(edges, run, capsys, monkeypatch):
    monkeypatch.setattr(edges.TranslatedMeshes, "steps", lambda self, press: np.arange(0))
    assert_refused(run, capsys, "no press of the test split converged")


def test_a_missing_dataset_is_one_line(run, capsys, tmp_path):
    assert_refused(run, capsys, "none.zarr", dataset=tmp_path / "none.zarr")


def test_an_unknown_way_is_one_line(run, capsys):
    assert_refused(run, capsys, "--way 'best': allowed: ", "--way", "best")


def assert_refused(run, capsys, words: str, *arguments: str, **options) -> None:
    capsys.readouterr()
    with pytest.raises(SystemExit, match="2"):
        run(*arguments, **options)
    said = capsys.readouterr().err
    assert words in said and said.count("\n") == 1
