"""CSV files of forces: what is read, what is left out, and the one line about each broken form."""

import numpy as np
import pytest

from simgen.calibration.measured_forces import MOST_POINTS, average, read_forces
from simgen.errors import InputError


def written(folder, text):
    file = folder / "forces.csv"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return file


def test_columns_come_in_any_order_and_case(tmp_path):
    found = read_forces(written(tmp_path, "\ufeffForce_N,time_s,depth_mm\n1.5,0,0.5\n6,1,1.0\n"))
    np.testing.assert_allclose(found.depth_mm, [0.5, 1.0])
    np.testing.assert_allclose(found.force_n, [1.5, 6.0])
    np.testing.assert_allclose(found.sigma_n, [1.5, 6.0])  # relative errors
    assert not found.has_std and found.left_out == () and found.deepest_mm == 1.0


def test_rows_without_load_are_left_out(tmp_path):
    found = read_forces(written(tmp_path, "depth_mm,force_n\n0,0.01\n0.1,-0.02\n\n0.5,1.5\n1.0,6\n"))
    assert found.left_out == (3,) and found.before_zero == (2,)
    np.testing.assert_allclose(found.depth_mm, [0.5, 1.0])


def test_repeats_are_averaged(tmp_path):
    found = read_forces(written(tmp_path, "depth_mm,force_n,std_n\n0.5,1,0.3\n0.5,2,0.4\n1.0,6,0.1\n"))
    np.testing.assert_allclose(found.force_n, [1.5, 6.0])
    np.testing.assert_allclose(found.sigma_n, [0.25, 0.1])  # of a mean: sqrt(0.3^2 + 0.4^2) / 2
    np.testing.assert_allclose(found.means(np.array([1.0, 3.0, 7.0])), [2.0, 7.0])
    assert found.has_std


def test_a_long_curve_becomes_a_few_points():
    depth = np.linspace(0.001, 2.0, 5000)
    found = average(np.column_stack([depth, depth**1.5]))
    assert len(found.depth_mm) == MOST_POINTS and (np.diff(found.depth_mm) > 0.0).all()
    np.testing.assert_allclose(found.means(depth**1.5), found.force_n)  # not the force at the mean depth
    assert found.force_n[0] > 1.05 * found.depth_mm[0] ** 1.5


def test_rows_of_an_interval_are_not_independent():
    depth = np.linspace(0.001, 2.0, 5000)
    found = average(np.column_stack([depth, depth**1.5, np.where(np.arange(5000) % 2, 0.03, 0.04)]))
    np.testing.assert_allclose(found.sigma_n, np.sqrt(0.5 * (0.03**2 + 0.04**2)))  # not over sqrt(250)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "first line '': allowed: depth_mm,force_n"),
        ("depth,force\n1,2\n", "first line 'depth,force': allowed: depth_mm,force_n and perhaps std_n"),
        ("depth_mm;force_n\n1;2\n", "first line 'depth_mm;force_n'"),
        ("depth_mm,force_n,Force_N\n1,2,3\n", "each once"),
        ("depth_mm,force_n\n0.5,1\n1.0,many\n", "line 3: force_n 'many': allowed: a number"),
        ("depth_mm,force_n\n0.5,1\n1.0,\n", "line 3: force_n ''"),
        ("depth_mm,force_n\n0.5,1\n1.0\n", "line 3: force_n ''"),
        ("depth_mm,force_n\n0.5,1\n0.5,1,65\n", "line 3: 3 cells; allowed: 2, as in the first line"),
        ("depth_mm,force_n\n0.5,nan\n1.0,2\n", "line 2: force_n 'nan'"),
        ("depth_mm,force_n\n0.5,1\ninf,2\n", "line 3: depth_mm 'inf'"),
        ("depth_mm,force_n,std_n\n0.5,1,0\n1,2,1\n", "line 2: std_n '0': allowed: a number above 0"),
        ("depth_mm,force_n\n0.5,1\n0.5,2\n", "1 depths with a depth and a force above 0; allowed: 2 and more"),
        ("depth_mm,force_n\n0.5,-1\n1.0,-2\n", "0 depths with a depth and a force above 0"),
        (b"depth_mm,force_n\n0.5,\xff\n", "not a CSV file"),
        (b"depth_mm,force_n\n0.5,1\x00\n", "line 2: force_n '1"),
    ],
)
def test_a_broken_file_gets_one_line(tmp_path, text, words):
    with pytest.raises(InputError, match=r"forces\.csv") as error:
        read_forces(written(tmp_path, text))
    assert words in str(error.value)


def test_a_missing_file_gets_one_line(tmp_path):
    for path in (tmp_path / "none.csv", tmp_path):
        with pytest.raises(InputError, match="cannot be read"):
            read_forces(path)
