"""Error lines of a sensor.yaml."""

import shutil

import pytest

from sensors.slab import SLAB, SOLID, write_sensor
from simgen.errors import InputError
from simgen.sensors.sensor import load_sensor

MESH = {"file": "slab.stl", "unit": "mm"}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"colour": "red"}, "colour: unknown key; allowed: name, gel, held"),
        ({"gel": {"mesh": {**MESH, "unit": "cm"}}}, 'gel.mesh.unit: "cm" is not allowed; allowed: m or mm'),
        ({"gel": {"mesh": {**MESH, "size": 1}}}, "gel.mesh.size: unknown key; allowed: file, unit"),
        ({"gel": {}}, "gel: exactly one of mesh, polar_shell, dome, pad is needed, found none"),
        ({"gel": {"mesh": {**MESH, "file": "none.stl"}}}, "none.stl: no such mesh file"),
        ({"held": {}}, "held: {} is not allowed; allowed: .*at least one"),
        ({"held": {"back": {"plane": {"axis": "w", "at_mm": 2.0}}}}, 'held.back.plane.axis: "w" is not .* x, y or z'),
        ({"held": {"back": {"plane": {"axis": "y", "at_mm": 9.0}}}}, "held.back: selects no triangle"),
        ({"held": {"back": {"box": {}}}}, "held.back.box: at least one of x_mm, y_mm, z_mm is needed"),
        ({"meshes": {"default": "as_given"}}, "as_given needs a file of tetrahedra"),
        ({"meshes": {"default": {"edge_length_mm": -1.0}}}, "edge_length_mm: -1.0 is not .* above 0, to 10000 mm"),
        ({"materials": {"solid": {**SOLID, "poisson_ratio": 0.5}}}, "poisson_ratio: 0.5 is not .* 0.01 to 0.49999"),
        ({"materials": {"solid": {**SOLID, "friction": float("nan")}}}, "solid.friction: NaN is not .* 0 to 2"),
        ({"materials": {"solid": {**SOLID, "c20_pa": 1e3}}}, "materials.solid: .*constants of law: yeoh"),
        ({"materials": {"solid": {**SOLID, "law": "gent"}}}, 'solid.law: "gent" .*allowed: neo_hookean or yeoh'),
        ({"core": {"friction": 0.0, "mesh": MESH}}, "core: the gel has no cavity"),
        ({"markers": {"file": "dots.csv", "diameter_mm": 0.9}}, "markers are seen by a camera: cameras are needed"),
        ({"markers": {"file": "dots.csv"}}, "markers.diameter_mm: missing; allowed: above 0, to 10000 mm"),
        ({"name": "bad name"}, 'name: "bad name" is not allowed; allowed: letters, digits'),
    ],
)
def test_errors_are_one_line_with_file_key_value_and_what_is_allowed(slab_folder, tmp_path, change, says):
    folder = write_sensor(tmp_path / "bad", {**SLAB, **change})
    shutil.copy(slab_folder / "slab.stl", folder)
    with pytest.raises(InputError, match=says) as error:
        load_sensor(folder)
    assert "\n" not in str(error.value)
    assert str(folder) in str(error.value)
