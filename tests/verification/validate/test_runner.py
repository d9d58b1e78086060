"""Running cases in processes, choosing them, and their context."""

import os
import re
from dataclasses import replace

import pytest

from simgen.errors import InputError
from simgen.verification.validate import runner
from simgen.verification.validate.case import Context
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
    assert dict(os.environ) == environment  # the workers' limit of one core is undone
    return results


def test_a_case_that_crashes_is_a_result_and_the_others_run(results):
    assert [result.case for result in results] == list(FAKES)
    assert {result.case: result.verdict for result in results} == VERDICTS
    errors = {result.case: result.error for result in results if result.error}
    assert re.fullmatch(r"RuntimeError: the increment to 1 mm stalled \(fakes.py, line \d+\)", errors["raises"])
    assert errors["dies"] == runner.DIED
    assert [result.case for result in results if result.failed] == ["misses", "raises", "dies", "compares_nothing"]


def test_bad_input_of_a_case_is_its_own_line(tmp_path):
    def refuse(context):
        raise InputError("a.csv: first line: pdc missing; allowed: column pdc")

    result = runner.run_case(replace(FAKES["raises"], solve=refuse), Context("cpu", None, None, tmp_path, None))
    assert result.verdict == "error" and result.error == "a.csv: first line: pdc missing; allowed: column pdc"


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
