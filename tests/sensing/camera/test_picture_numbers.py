"""CSV files with numbers for each picture; tests of other forms of them are in test_contact_circles.py."""

import pytest

from simgen.errors import InputError
from simgen.sensing.camera.picture_numbers import check_listed, read_picture_numbers


def test_numbers_are_read_by_their_columns(tmp_path):
    (tmp_path / "p.csv").write_text("y_mm,file,x_mm\n1,a.png,2.5\n-3,b/c.png,4e-1\n")
    found = read_picture_numbers(tmp_path / "p.csv", ("x_mm", "y_mm"), "mm")
    assert found == {tmp_path / "a.png": [2.5, 1.0], tmp_path / "b" / "c.png": [0.4, -3.0]}


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("file,x_mm\na.png,1\n", "first line 'file,x_mm': allowed: file,x_mm,y_mm"),
        ("file,x_mm,y_mm\na.png,1,2\nb.png,1,far\n", "line 3: y_mm 'far': allowed: a number of mm"),
        ("file,x_mm,y_mm\na.png,inf,2\n", "line 2: x_mm 'inf': allowed: a number of mm"),
        ("file,x_mm,y_mm\na.png,1,2\n./a.png,1,3\n", "line 3: file './a.png': allowed: each picture once"),
    ],
)
def test_other_files_are_one_line(tmp_path, text, complaint):
    (tmp_path / "p.csv").write_text(text)
    with pytest.raises(InputError) as raised:
        read_picture_numbers(tmp_path / "p.csv", ("x_mm", "y_mm"), "mm")
    assert str(raised.value) == f"{tmp_path / 'p.csv'}: {complaint}"


def test_strangers_are_refused(tmp_path):
    numbers = {tmp_path / "a.png": [1.0], tmp_path / "b.png": [2.0]}
    check_listed(tmp_path / "p.csv", numbers, [tmp_path / "b.png", tmp_path / "a.png", tmp_path / "c.png"])
    with pytest.raises(InputError, match=r"p\.csv: .*b\.png is none of the pictures"):
        check_listed(tmp_path / "p.csv", numbers, [tmp_path / "a.png"])
