"""CSV files of the user: cells by column, and one line for each fault."""

import pytest

from simgen.config.csv_files import csv_lines, csv_number
from simgen.errors import InputError


def written(folder, text: str, encoding: str = "utf-8"):
    file = folder / "a.csv"
    file.write_bytes(text.encode(encoding))
    return file


def test_columns_may_come_in_any_order(tmp_path):
    file = written(tmp_path, "\ufeffy,x\n1,2\n3,4\n")
    assert list(csv_lines(file, ("x", "y"))) == [
        (f"{file}: line 2", {"y": "1", "x": "2"}),
        (f"{file}: line 3", {"y": "3", "x": "4"}),
    ]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "first line '': allowed: x,y"),
        ("x,z\n1,2\n", "first line 'x,z': allowed: x,y"),
        ("x,y,x\n1,2,3\n", "first line 'x,y,x': allowed: x,y"),
        ("x,y\n1,2\n0,5,1\n", "line 3: not 2 cells; allowed: one for each of x,y"),
        ("x,y\n1\n", "line 2: not 2 cells"),
    ],
)
def test_faults_name_the_line(tmp_path, text, words):
    file = written(tmp_path, text)
    with pytest.raises(InputError) as error:
        list(csv_lines(file, ("x", "y")))
    assert str(error.value).startswith(str(file)) and words in str(error.value)


def test_files_that_are_not_there_or_no_text_are_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be read: No such file"):
        list(csv_lines(tmp_path / "b.csv", ("x",)))
    with pytest.raises(InputError, match="not a CSV file"):
        list(csv_lines(written(tmp_path, "x\n\xe4\n", "latin-1"), ("x",)))


def test_numbers_are_finite():
    assert csv_number("1e-3", "here", "mm") == 1e-3
    for text in ("", "one", "nan", "inf"):
        with pytest.raises(InputError, match=f"^here '{text}': allowed: a number of mm$"):
            csv_number(text, "here", "mm")
