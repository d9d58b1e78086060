"""The JSON record of the results."""

import json

import pytest

from simgen.verification.validate.record import write_json
from tests.verification.validate.fakes import made_up_results


def test_the_record_holds_rows_curves_machine_and_code_in_strict_json(tmp_path):
    results = made_up_results(tmp_path)
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
