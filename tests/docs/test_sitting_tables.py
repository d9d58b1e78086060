"""The tables of networks on the pages are those of the record of the sitting."""

import pytest
from sitting_tables import DOCS, PAGES, page_with_tables


@pytest.mark.parametrize("page", PAGES)
def test_the_page_has_the_tables_of_the_record(page):
    """If not, run `python docs/generate/sitting_tables.py`."""
    assert page_with_tables(page) == (DOCS / page).read_text()
