"""Console view of a training: the files that it names, and tables of errors in at most 80 columns."""

import io
import sys
from dataclasses import replace

import pytest
from learning.model_errors import entries, entry, errors
from rich.console import Console
from typer.testing import CliRunner

from simgen.cli import train
from simgen.cli.app import app
from simgen.cli.train import console_tables, train_with_progress
from simgen.errors import InputError
from simgen.learning.training.evaluate import FIGURE
from tests.learning import touched


def test_a_picture_is_named_where_there_is_one(with_electrodes, tmp_path, capsys):
    for names, there in ((["svb"], False), (["rmd"], True)):
        train_with_progress(touched.job(with_electrodes.path, networks=names), tmp_path / names[0], "cpu", False)
        assert (tmp_path / names[0] / FIGURE).exists() == (FIGURE in capsys.readouterr().out) == there


def test_without_tables_it_only_trains(with_electrodes, tmp_path, capsys):
    """The same command measures later, and trains nothing again."""
    job, output = touched.job(with_electrodes.path, networks=["svb"]), tmp_path / "out"
    train_with_progress(job, output, "cpu", False, tables=False)
    weights = (output / "svb" / "network.safetensors").stat().st_mtime_ns
    assert not (output / "table.md").exists() and "table.md" not in capsys.readouterr().out
    train_with_progress(job, output, "cpu", False)
    assert (output / "table.md").exists()
    assert (output / "svb" / "network.safetensors").stat().st_mtime_ns == weights


@pytest.mark.parametrize("words, tables", [([], True), (["--no-tables"], False)])
def test_the_option_no_tables_is_passed_on(monkeypatch, words, tables):
    asked = []
    monkeypatch.setattr(train, "train_with_progress", lambda *given, tables: asked.append(tables))
    assert CliRunner().invoke(app, ["train", "training_smoke", *words]).exit_code == 0
    assert asked == [tables]


def test_tensorboard_that_is_missing_is_one_line(with_electrodes, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    job = touched.job(with_electrodes.path, networks=["svb"])
    with pytest.raises(InputError, match=r"^--tensorboard: tensorboard is not installed; allowed: pip install"):
        train_with_progress(job, tmp_path / "out", "cpu", True)


def printed(models, width: int) -> list[str]:
    """The lines of the console's tables."""
    console = Console(width=width, record=True, file=io.StringIO())
    for each in console_tables(models):
        console.print(each)
    return console.export_text().splitlines()


def test_the_console_shows_means_and_what_they_are_beside_the_bar():
    split = [line.strip().split("  ") for line in printed(entries(), 80)]
    lines = {cells[0]: " ".join(cells).split() for cells in reversed(split)}  # the first of each
    assert lines["model"] == ["model", "RMSE", "region", "MED", "p99", "overlap", "params", "note"]
    assert lines["PCA-128"][1:] == ["20.00", "19.5", "20.0", "60.0", "-", "1.2k", "1.00"]
    assert lines["MVD"][1:] == ["30.00", "29.5", "30.0", "90.0", "-", "1.2k", "1.5", "worse"]
    assert lines["MVD (ACROSS)"][2:] == ["9.28", "12.4", "-", "-", "-", "-", "published"]
    assert lines["ours"][-1] == "0.50"
    assert lines["SVB"][1:] == ["0.0600", "99"]
    assert any("Note: RMSE over that of PCA-128." in line for line in printed(entries(), 80))


@pytest.mark.parametrize("width", [80, 120])
def test_the_longest_names_and_errors_of_a_millimetre_fit_on_the_console(width):
    names = {"rest": 0, "ridge to PCA-128": 123_456, "S2MPN, M2MPN": 98_765_432, "S2RM, RM2RM (ours)": 1_234_567_890}
    own = {name: entry(name, 312.0, baseline=name.startswith("ridge")) for name in names}
    models = [replace(own[name], parameters=count, errors=errors(312.0, 0.5)) for name, count in names.items()]
    lines = [line for line in printed(models, width) if line.strip()]
    assert all(len(line.rstrip()) <= width for line in lines)
    rows = [line for line in lines if "312.00" in line]
    assert [line[:20].strip() for line in rows] == list(names)  # a row each, no name in two lines
    assert [line.split("0.500")[1].split()[0] for line in rows] == ["0", "123.5k", "98.8M", "1.2G"]
