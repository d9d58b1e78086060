"""Published meshes as sensors, and how a mesh is found."""

import pytest

from simgen.sensors.sensor import load_sensor
from simgen.verification.validate.published_sensors import mesh_with, published_sensor, published_sensors


def test_published_meshes_are_sensors(reference, tmp_path):
    """They have the files' vertices and our held regions: the flat back, nail plate and rear face."""
    assert published_sensors(reference) == ["digit", "biotac"]
    digit, biotac = (published_sensor(reference, name, tmp_path) for name in ("digit", "biotac"))
    assert (len(digit.output_mesh.vertices), len(biotac.output_mesh.vertices)) == (1834, 4246)
    assert digit.output_mesh.held.sum() == pytest.approx(303, abs=10)
    assert biotac.output_mesh.held.sum() == pytest.approx(144 + 30, abs=5)
    assert biotac.core is not None and biotac.core_friction == load_sensor("biotac").core_friction


def test_a_published_mesh_is_found_by_its_number_of_vertices(reference):
    assert len(mesh_with("digit", 1834, reference).vertices) == 1834
    assert len(mesh_with("biotac", 4246, reference).vertices) == 4246
