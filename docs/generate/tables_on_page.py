"""Tables on a page: each stands between two marks, which name the script that prints it."""

from collections.abc import Callable, Sequence

Table = Callable[[], str]


def with_tables(text: str, tables: Sequence[Table], script: str) -> str:
    """Replace the tables in the text of a page. A table belongs between the marks with its function's name.

    Raises `ValueError` if a mark is missing.
    """
    for table in tables:
        first, last = f"<!-- {table.__name__}: printed by docs/generate/{script} -->", f"<!-- /{table.__name__} -->"
        before, begins, rest = text.partition(first)
        _, ends, after = rest.partition(last)
        if not (begins and ends):
            raise ValueError(f"the page needs both marks, {first} and {last}")
        text = f"{before}{first}\n\n{table()}\n\n{last}{after}"
    return text
