"""The tables of outputs on the page of the dataset are those of the code."""

from output_reference import PAGE, page_with_tables


def test_the_page_has_the_tables_of_the_code():
    """If not, run `python docs/generate/output_reference.py`."""
    text = PAGE.read_text()
    assert page_with_tables(text) == text
