"""`simgen validate` and the table that it prints."""

import json
import sys

import pytest
from refusal import simgen
from typer.testing import CliRunner

from simgen.cli import app as cli
from simgen.cli import validate as view
from simgen.verification.validate import runner
from tests.verification.validate.fakes import FAKES, made_up_results


def test_a_case_is_run_printed_and_written(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    command = "validate --case exact-frame --json v.json --html v.html"
    code, output, errors = simgen(command, monkeypatch, capfd)
    assert code == 0, errors
    for words in ("largest force after a rigid motion", "rounding of float64", "no rows fail"):
        assert words in output
    stored = json.loads((tmp_path / "v.json").read_text())
    assert [case["case"] for case in stored["cases"]] == ["exact-frame"]
    assert "exact-frame" in (tmp_path / "v.html").read_text()


def test_the_list_names_every_case_with_its_level(monkeypatch, capfd):
    monkeypatch.setattr(view.console, "width", 100)
    code, output, _ = simgen("validate --list", monkeypatch, capfd)
    assert code == 0
    for case in runner.all_cases().values():
        assert case.name in output


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["--case", "nothing"], "case 'nothing' is not known; allowed: "),
        (["--device", "gpu"], "device 'gpu' is not allowed; allowed: cpu"),
        (["--published", "gone"], "--published = gone: no such folder"),
        (["--measured", "gone"], "--measured = gone: no such folder"),
        (["--json", "gone/v.json"], "gone/v.json: no such folder gone"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(monkeypatch, capfd, arguments, words):
    monkeypatch.setattr(sys, "argv", ["simgen", "validate", *arguments])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code == 2
    said = capfd.readouterr().err
    assert said.startswith("simgen: ") and len(said.splitlines()) == 1
    assert words in said


@pytest.mark.parametrize("name, code", [("passes", 0), ("skips", 0), ("misses", 1), ("raises", 1)])
def test_the_exit_code_is_1_if_a_row_fails_or_a_case_ends_by_an_error(monkeypatch, name, code):
    monkeypatch.setattr(runner, "choose", lambda names, quick: [FAKES[name]])
    monkeypatch.setattr(view, "run_cases", lambda cases, context, *_: [runner.run_case(cases[0], context)])
    monkeypatch.delenv("SIMGEN_REFERENCE", raising=False)
    assert CliRunner().invoke(cli.app, ["validate"]).exit_code == code


def test_the_table_names_every_row_and_every_reason(tmp_path, capsys):
    view.print_results(made_up_results(tmp_path))
    text = " ".join(capsys.readouterr().out.split())
    for words in ("+0.05 %", "a closed form", "at least 2.8", "+6 %", "set $SIMGEN_REFERENCE", "stalled",
                  "compared nothing", "4 rows of 6 cases: 1 rows fail", "ended by an error: raises, dies"):  # fmt: skip
        assert words in text, words
