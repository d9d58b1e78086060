"""Running, recording and showing cases, with cases that are made up."""

import json
import os
import re
from pathlib import Path

import pytest

from simgen.cli import validate as view
from simgen.errors import InputError
from simgen.verification.validate import runner
from simgen.verification.validate.case import Context
from simgen.verification.validate.page import draw_curves, write_validation
from simgen.verification.validate.record import write_json
from tests.verification.validate.fakes import FAKES

VERDICTS = {"passes": "ok", "misses": "FAIL", "skips": "skipped", "raises": "error", "dies": "error",
            "compares_nothing": "FAIL"}  # fmt: skip


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    context = Context("cpu", None, None, tmp_path_factory.mktemp("scratch"))
    told, environment = [], dict(os.environ)
    results = runner.run_cases(list(FAKES.values()), context, 2, lambda result: told.append(result.case))
    assert sorted(told) == sorted(FAKES)
    assert not list(context.scratch.iterdir())  # the cases' own folders are gone
    assert dict(os.environ) == environment  # what keeps the workers to one core is not for those that come later
    return results


def test_a_case_that_crashes_is_a_result_and_the_others_run(results):
    assert [result.case for result in results] == list(FAKES)
    assert {result.case: result.verdict for result in results} == VERDICTS
    errors = {result.case: result.error for result in results if result.error}
    assert re.fullmatch(r"RuntimeError: the increment to 1 mm stalled \(fakes.py, line \d+\)", errors["raises"])
    assert errors["dies"] == runner.DIED
    assert [result.case for result in results if result.failed] == ["misses", "raises", "dies", "compares_nothing"]


def test_the_record_holds_rows_curves_machine_and_code_in_strict_json(results, tmp_path):
    write_json(results, "cpu", tmp_path / "v.json")

    def refuse(constant):
        raise AssertionError(constant)

    stored = json.loads((tmp_path / "v.json").read_text(), parse_constant=refuse)
    assert stored["machine"]["device"] == "cpu" and stored["machine"]["processor"]
    assert len(stored["code"]["source"]) == 64
    cases = {entry["case"]: entry for entry in stored["cases"]}
    force, order = cases["passes"]["rows"]
    assert force["verdict"] == "ok" and force["difference"] == pytest.approx(3.21 / 3.2084 - 1.0)
    assert order["reference"] is None  # JSON has no NaN
    assert cases["passes"]["curves"][2]["log"] and cases["passes"]["tables"][0]["rows"][1] == ["a peer", None]
    assert cases["skips"]["skipped"] and cases["raises"]["error"]
    assert all(entry["seconds"] >= 0.0 for entry in cases.values())


def test_the_table_names_every_row_and_every_reason(results, capsys):
    view.print_results(results)
    text = " ".join(capsys.readouterr().out.split())
    for words in ("+0.05 %", "a closed form", "at least 2.8", "+6 %", "set $SIMGEN_REFERENCE", "stalled",
                  "compared nothing", "4 rows of 6 cases: 1 rows fail", "ended by an error: raises, dies"):  # fmt: skip
        assert words in text, words


def test_the_page_is_self_contained_and_escapes_its_texts(results, tmp_path):
    write_validation(results, "cpu", tmp_path / "v.html")
    page = (tmp_path / "v.html").read_text()
    assert page.count("data:image/webp;base64,") == 1
    assert "http" not in page
    assert page.count("<span class='fail'>FAIL</span>") == 2 * 2 + 1  # two cases, twice each; one row
    assert "1.235" in page and "A note." in page


def test_curves_of_one_plot_share_its_axes():
    curves = FAKES["passes"].solve(Context("cpu", None, None, Path())).curves
    force, error = draw_curves(curves).axes
    assert len(force.lines) == 2 and force.get_xlabel() == "depth, mm" and force.get_xscale() == "linear"
    assert len(error.lines) == 1 and error.get_yscale() == "log"


def test_cases_are_chosen_by_level_or_by_name():
    cases = runner.all_cases()
    by_level = {level: [c for c in cases.values() if c.level == level] for level in ("quick", "standard", "long")}
    assert runner.choose([], quick=True) == by_level["quick"]
    assert set(runner.choose([], quick=False)) == {*by_level["quick"], *by_level["standard"]}
    name = next(iter(cases))
    assert runner.choose([name, name], quick=True) == [cases[name]]
    with pytest.raises(InputError, match=rf"case 'nothing' is not known; allowed: {name}, "):
        runner.choose([name, "nothing"], quick=False)


def test_folders_and_devices_that_are_not_there_are_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("SIMGEN_REFERENCE", str(tmp_path))
    assert runner.make_context("cpu", None).reference == tmp_path
    with pytest.raises(InputError, match=r"--published = .*gone: no such folder"):
        runner.make_context("cpu", tmp_path / "gone")
    with pytest.raises(InputError, match=r"device 'gpu' is not allowed"):
        runner.make_context("gpu", None)
    monkeypatch.setenv("SIMGEN_REFERENCE", str(tmp_path / "gone"))
    with pytest.raises(InputError, match=r"\$SIMGEN_REFERENCE = .*gone: no such folder"):
        runner.make_context("cpu", None)
