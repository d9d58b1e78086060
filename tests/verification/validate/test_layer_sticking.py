"""The case of the sticking sphere, as it is run."""

from simgen.verification.validate import layer_sticking
from simgen.verification.validate.case import Context
from simgen.verification.validate.layer_sticking import solve_sticking


def test_a_shallow_press_agrees_with_the_axisymmetric_code(monkeypatch, tmp_path):
    monkeypatch.setattr(layer_sticking, "DEPTHS_MM", (0.2, 0.4))
    monkeypatch.setattr(layer_sticking, "STEPS_MM", {"fine": (), layer_sticking.COARSE: (0.1,)})
    outcome = solve_sticking(Context("cpu", None, None, tmp_path))
    assert len(outcome.rows) == 2 and len(outcome.tables[0].rows) == 1
    assert all(row.passed for row in outcome.rows), outcome.tables[0].rows
