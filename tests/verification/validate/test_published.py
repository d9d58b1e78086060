"""The cases of published data: their bounds, and every reason to skip."""

import pytest

from tests.verification.validate.fakes import outcome_of

NAMES = ["published-geometry", "published-digit", "published-biotac", "published-deep", "published-results"]


@pytest.mark.parametrize("name", NAMES)
def test_without_data_a_case_is_skipped_with_its_reason(name, tmp_path):
    absent, empty = outcome_of(name, None, tmp_path), outcome_of(name, tmp_path, tmp_path)
    assert "no --published DIR" in absent.skipped
    assert str(tmp_path) in empty.skipped
    assert not absent.rows + empty.rows


def test_published_geometry_is_within_the_bounds(reference, tmp_path):
    outcome = outcome_of("published-geometry", reference, tmp_path)
    assert len(outcome.rows) == 2 * 6 + 8
    assert [row.quantity for row in outcome.rows if not row.passed] == []
