"""Error lines of the section ``markers``."""

import pytest

from simgen.config.strict_section import section_from_dict
from simgen.errors import InputError
from simgen.sensors.marker_schema import MarkerSettings

GRID = {"rows": 7, "columns": 9, "pitch_mm": 2.05}


def test_dots_are_black_and_in_the_middle_by_default():
    markers = section_from_dict(MarkerSettings, {"grid": GRID, "diameter_mm": 0.9}, "a")
    assert markers.darkness == 1.0 and markers.grid.center_mm is None


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"file": "dots.csv"}, "exactly one of grid, file is needed, found both"),
        ({"grid": None}, "exactly one of grid, file is needed, found none"),
        ({"grid": None, "file": "../dots.csv"}, "file: '../dots.csv' leads out of the sensor's folder"),
        ({"grid": GRID | {"rows": 0}}, "grid.rows: 0 is not allowed; allowed: a whole number, 1 to 100"),
        ({"grid": GRID | {"pitch_mm": 0.0}}, "grid.pitch_mm: 0.0 is not allowed; allowed: above 0"),
        ({"grid": GRID | {"size": 2}}, "grid.size: unknown key; allowed: rows, columns, pitch_mm, center_mm"),
        ({"diameter_mm": -1.0}, "diameter_mm: -1.0 is not allowed; allowed: above 0"),
        ({"darkness": 1.5}, "darkness: 1.5 is not allowed; allowed: above 0, to 1"),
    ],
)
def test_errors_name_key_value_and_what_is_allowed(change, says):
    with pytest.raises(InputError) as error:
        section_from_dict(MarkerSettings, {"grid": GRID, "diameter_mm": 0.9} | change, "sensor.yaml")
    assert says in str(error.value) and "\n" not in str(error.value)
