"""The case of four forces on a GelSight Mini, on its coarse mesh."""

import pytest

from simgen.verification.measured import gelsight_force
from simgen.verification.validate.case import Context


def test_it_is_skipped_without_forces(tmp_path):
    for measured in (None, tmp_path):
        outcome = gelsight_force.gelsight_force(Context("cpu", None, None, tmp_path, measured))
        assert outcome.rows == [] and gelsight_force.FILE in outcome.skipped


@pytest.mark.slow
def test_the_forces_are_met_on_the_coarse_mesh(reference, tmp_path, monkeypatch):
    """The coarse mesh is itself off by as much as the best residual, so that row may fail."""
    folder = reference / "measured"
    if not (folder / gelsight_force.FILE).is_file():
        pytest.skip(f"no {gelsight_force.FILE}: the forces belong to others")
    monkeypatch.setattr(gelsight_force, "MESH", "coarse")
    outcome = gelsight_force.gelsight_force(Context("cpu", None, None, tmp_path, folder))
    assert [row.quantity for row in outcome.rows if not row.passed and "mesh" not in row.quantity] == []
    table = outcome.tables[0].rows
    assert len(table) == 4 and table[-1][0] == "E; nu 0.475, friction 0.9"  # fits worst
    assert all(500.0 > row[1] > 400.0 for row in table if row[0].startswith("E; "))
