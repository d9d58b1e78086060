"""Where dots are printed: the sensor's own grid or file, a grid by text, and files with their error lines."""

from pathlib import Path

import numpy as np
import pytest

from simgen.errors import InputError
from simgen.sensors.marker_layout import MOST, MarkerLayout, read_points
from simgen.sensors.marker_schema import MarkerGrid, MarkerSettings
from simgen.sensors.sensor_geometry import sensor_folder
from simgen.sensors.sensor_schema import read_description

FOLDER = sensor_folder("gelsight_mini")
MINI = read_description(FOLDER / "sensor.yaml")
DIGIT = read_description(sensor_folder("digit") / "sensor.yaml")


def with_markers(**markers):
    return MINI.model_copy(update={"markers": MarkerSettings(**markers)})


def test_the_gelsight_mini_has_its_own_grid():
    own = MarkerLayout.of("own", MINI, FOLDER)
    same = MarkerLayout.of("7x9@2.05", MINI, FOLDER)
    assert own.points.shape == (63, 3) and own.diameter == pytest.approx(0.9e-3) and own.along_axis
    np.testing.assert_array_equal(own.points, same.points)
    assert own.names[10].endswith("sensor.yaml: markers.grid: row 2, column 2")
    assert same.names[10] == "--markers 7x9@2.05: row 2, column 2"


def test_a_grid_goes_right_and_then_down_around_the_camera_s_axis():
    layout = MarkerLayout.of("2x3@1.5", MINI, FOLDER)
    view = 1e3 * layout.camera.in_view(layout.points)[:, :2]
    expected = [[-1.5, 0.75], [0.0, 0.75], [1.5, 0.75], [-1.5, -0.75], [0.0, -0.75], [1.5, -0.75]]
    np.testing.assert_allclose(view, expected, atol=1e-12)


def test_a_grid_has_the_given_center_and_the_diameter_replaces_the_own_one():
    grid = MarkerGrid(rows=1, columns=1, pitch_mm=1.0, center_mm=(-7.0, 0.0, 2.0))
    layout = MarkerLayout.of("own", with_markers(grid=grid, diameter_mm=0.9, darkness=0.5), FOLDER, 0.7)
    np.testing.assert_allclose(layout.points, [[-7e-3, 0.0, 2e-3]])
    assert (layout.diameter, layout.darkness) == (pytest.approx(0.7e-3), 0.5)


def test_a_file_of_points_is_read(tmp_path):
    (tmp_path / "dots.csv").write_text("z_mm,x_mm,y_mm\n1,2,3\n4,5,6.5\n")
    given = MarkerLayout.of(str(tmp_path / "dots.csv"), DIGIT, Path("digit"), 1.0)
    own = MarkerLayout.of("own", with_markers(file="dots.csv", diameter_mm=0.9), tmp_path)
    for layout in (given, own):
        np.testing.assert_allclose(layout.points, [[2e-3, 3e-3, 1e-3], [5e-3, 6.5e-3, 4e-3]])
        assert not layout.along_axis and layout.names[1] == f"{tmp_path / 'dots.csv'}: line 3"


@pytest.mark.parametrize(
    ("choice", "diameter", "says"),
    [
        ("own", None, "--markers own: digit/sensor.yaml has no markers; allowed: ROWSxCOLUMNS@PITCH, or a CSV file"),
        ("7x9@2", None, "--markers 7x9@2: --dot-mm is missing, and digit/sensor.yaml has no markers"),
        ("7x9@2", 0.0, "--dot-mm 0: allowed: above 0, to 100 mm"),
        ("7x9@2", float("nan"), "--dot-mm nan: allowed: above 0, to 100 mm"),
        ("7x9@2", 2.1, "--markers 7x9@2: dots of 2.1 mm overlap at a pitch of 2 mm; allowed: diameters up to"),
        ("foo", None, "--markers foo: allowed: own, ROWSxCOLUMNS@PITCH in mm such as 7x9@2.05, or a CSV file with"),
        ("7x9", 1.0, "--markers 7x9: allowed: own, ROWSxCOLUMNS@PITCH in mm such as 7x9@2.05, or a CSV file with"),
        ("0x9@2", 1.0, "--markers 0x9@2: rows: 0 is not allowed; allowed: a whole number, 1 to 100"),
        ("7x9@0", 1.0, "--markers 7x9@0: pitch_mm: 0.0 is not allowed; allowed: above 0"),
        ("nowhere.csv", 1.0, "nowhere.csv: cannot be read: No such file or directory"),
    ],
)
def test_each_wrong_choice_is_one_line(choice, diameter, says):
    with pytest.raises(InputError) as error:
        MarkerLayout.of(choice, DIGIT, Path("digit"), diameter)
    assert says in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("x,y,z\n1,2,3\n", "first line 'x,y,z': allowed: x_mm,y_mm,z_mm"),
        ("x_mm,y_mm,z_mm\n1,2,3\n1,two,3\n", "line 3: y_mm 'two': allowed: a number of mm"),
        ("x_mm,y_mm,z_mm\n1,2,3,5\n", "line 2: not 3 cells"),
        ("x_mm,y_mm,z_mm\n1,2\n", "line 2: not 3 cells; allowed: one for each of x_mm,y_mm,z_mm"),
        ("x_mm,y_mm,z_mm\n1,2,nan\n", "line 2: z_mm 'nan': allowed: a number of mm"),
        ("x_mm,y_mm,z_mm\n", f"0 points; allowed: 1 to {MOST}"),
        ("x_mm,y_mm,z_mm\n" + "1,2,3\n" * (MOST + 1), f"{MOST + 1} points; allowed: 1 to {MOST}"),
        ("", "first line '': allowed: x_mm,y_mm,z_mm"),
        ("x_mm,y_mm,z_mm\n\0\xff", "not a CSV file|line 2"),
    ],
)
def test_each_bad_file_is_one_line(tmp_path, content, says):
    file = tmp_path / "dots.csv"
    file.write_bytes(content.encode("latin-1"))
    with pytest.raises(InputError) as error:
        read_points(file)
    assert str(error.value).startswith(f"{file}: ") and "\n" not in str(error.value)
    assert any(words in str(error.value) for words in says.split("|"))
