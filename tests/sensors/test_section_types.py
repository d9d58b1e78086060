"""Types of values in a sensor.yaml."""

import pytest
from pydantic import TypeAdapter, ValidationError

from simgen.sensors.section_types import Direction, OwnFile


def test_a_direction_has_a_length():
    assert TypeAdapter(Direction).validate_python((0.0, 0.0, 2.0)) == (0.0, 0.0, 2.0)
    with pytest.raises(ValidationError, match="must have a length of 1e-3 to 1e3"):
        TypeAdapter(Direction).validate_python((0.0, 0.0, 0.0))


@pytest.mark.parametrize("file", ["/etc/passwd", "../gel.stl", "a/../../gel.stl"])
def test_a_file_lies_in_the_sensor_s_folder(file):
    assert TypeAdapter(OwnFile).validate_python("meshes/gel.stl") == "meshes/gel.stl"
    with pytest.raises(ValidationError, match="leads out of the sensor's folder"):
        TypeAdapter(OwnFile).validate_python(file)
