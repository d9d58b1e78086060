"""The table of outputs on the page of the dataset is that of the code."""

from output_reference import PAGE, page_with_table


def test_the_page_has_the_table_of_the_code():
    """If not, run `python docs/generate/output_reference.py`."""
    text = PAGE.read_text()
    assert page_with_table(text) == text
