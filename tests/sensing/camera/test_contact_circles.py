"""Contact circles are found in spite of noise, and files with circles are checked."""

import numpy as np
import pytest

from simgen.errors import InputError
from simgen.sensing.camera.contact_circles import find_circle, read_circles
from simgen.sensing.camera.spheres import Circle

NOISE = 2.0  # grey levels of a camera


def disk(circle: Circle, contrast: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A picture and its background (120, 90, 3) uint8: noise, and a brighter disk."""
    random = np.random.default_rng(seed)
    rows, columns = np.mgrid[:120, :90]
    inside = np.hypot(rows - circle.row, columns - circle.column) < circle.radius
    clean = np.full((120, 90, 3), 100.0)
    picture = clean + contrast * inside[..., None] * [0.2, 1.0, -0.5]
    return tuple((each + random.normal(0.0, NOISE, each.shape)).round().astype(np.uint8) for each in (picture, clean))


@pytest.mark.parametrize("contrast", [30.0, 100.0])
@pytest.mark.parametrize("circle", [Circle(40.3, 70.6, 15.2), Circle(60.0, 30.0, 25.0), Circle(45.5, 60.5, 6.0)])
def test_a_disk_is_found(circle, contrast):
    """To one pixel: a rim of pixels is known to half a pixel, and noise moves the outermost pixel by as much."""
    found = find_circle(*disk(circle, contrast))
    assert (found.column, found.row, found.radius) == pytest.approx((circle.column, circle.row, circle.radius), abs=1.0)


def test_the_largest_place_counts():
    picture, background = disk(Circle(30.0, 70.0, 15.0), 60.0)
    picture[10:13] += 80  # a scratch: brighter, longer, smaller
    found = find_circle(picture, background)
    assert (found.column, found.row) == pytest.approx((30.0, 70.0), abs=1.0)


def test_noise_is_no_contact():
    picture, background = disk(Circle(30.0, 70.0, 15.0), 0.0)
    with pytest.raises(InputError, match=r"no contact: at most [\d.]+ grey levels off the background; allowed: 8 and"):
        find_circle(picture, background)


def test_circles_are_read_by_their_names(tmp_path):
    file = tmp_path / "circles.csv"
    file.write_text("\ufefffile,radius,column,row\na.png,7.5,10,20.25\nmore/b.png,1,2,3\n", encoding="utf-8")
    circles = read_circles(file)
    assert circles == {tmp_path / "a.png": Circle(10.0, 20.25, 7.5), tmp_path / "more" / "b.png": Circle(2.0, 3.0, 1.0)}


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "first line '': allowed: file,column,row,radius"),
        ("file,column,row\na.png,1,2\n", "first line 'file,column,row': allowed: file,column,row,radius"),
        ("file,column,row,radius\na.png,1,2,much\n", "line 2: radius 'much': allowed: a number of pixels"),
        ("file,column,row,radius\na.png,1,2,3\nb.png,1,nan,3\n", "line 3: row 'nan': allowed: a number of pixels"),
        ("file,column,row,radius\na.png,1,2\n", "line 2: not 4 cells; allowed: one for each of file,column,row,radius"),
        (b"\xff\xfe\x00", "not a CSV file ("),
    ],
)
def test_other_files_are_one_line(tmp_path, text, complaint):
    file = tmp_path / "circles.csv"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError) as raised:
        read_circles(file)
    assert str(raised.value).startswith(f"{file}: {complaint}")
    with pytest.raises(InputError, match=r"nowhere\.csv: cannot be read: No such file"):
        read_circles(tmp_path / "nowhere.csv")
