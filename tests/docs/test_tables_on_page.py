"""Tables on a page: they replace what stands between their marks, and nothing else."""

import pytest
from tables_on_page import with_tables


def first() -> str:
    return "| 1 |"


def second() -> str:
    return "| 2 |"


PAGE = """Above.
<!-- first: printed by docs/generate/s.py -->
old
<!-- /first -->
Between.
<!-- second: printed by docs/generate/s.py -->
<!-- /second -->
Below.
"""


def test_tables_stand_between_their_marks():
    text = with_tables(PAGE, (first, second), "s.py")
    assert text == PAGE.replace("\nold\n", "\n\n| 1 |\n\n").replace(
        "s.py -->\n<!-- /second", "s.py -->\n\n| 2 |\n\n<!-- /second"
    )
    assert with_tables(text, (first, second), "s.py") == text


@pytest.mark.parametrize("mark", ["<!-- second: printed by docs/generate/s.py -->", "<!-- /second -->"])
def test_a_missing_mark_is_refused(mark):
    """The rest of the page would be lost."""
    with pytest.raises(ValueError, match="the page needs both marks, <!-- second: "):
        with_tables(PAGE.replace(mark, ""), (first, second), "s.py")
