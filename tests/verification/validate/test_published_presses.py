"""The same press on published tetrahedra and on ours."""

import pytest

from simgen.config.warp_device import start_warp
from simgen.verification.validate.published_presses import compare_presses


@pytest.mark.slow
def test_the_same_press_on_published_tetrahedra(reference, tmp_path):
    """Our mesh agrees with theirs with P2-P1. Linear tetrahedra lock, with 3 to 10 times the force."""
    start_warp()
    outcome = compare_presses(reference, "digit", ["sphere_7mm"], [0.2, 0.4], "cpu", tmp_path)
    assert len(outcome.rows) == 4
    assert [row.quantity for row in outcome.rows if not row.passed] == []
    (table,) = outcome.tables
    linear = [row for row in table.rows if row[0].endswith("linear")]
    assert min(row[3] for row in linear) > 200.0  # % more force
