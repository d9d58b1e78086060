"""The quick cases of `simgen validate`: every row within its tolerance."""

import pytest

from simgen.verification.validate import all_cases, runner
from simgen.verification.validate.case import Context

QUICK = [case for case in all_cases().values() if case.level == "quick"]


@pytest.fixture(scope="module")
def context(request, tmp_path_factory) -> Context:
    try:
        reference = request.getfixturevalue("reference")
    except pytest.skip.Exception:
        reference = None
    return Context("cpu", reference, None, tmp_path_factory.mktemp("validate"))


@pytest.mark.parametrize("case", QUICK, ids=lambda case: case.name)
def test_quick_case(case, context):
    result = runner.run_case(case, context)
    if result.verdict == "skipped":
        pytest.skip(result.outcome.skipped)
    assert not result.error
    assert result.outcome.rows
    assert [row for row in result.outcome.rows if not row.passed] == []
