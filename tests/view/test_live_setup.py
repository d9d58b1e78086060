"""What live pages share: loaded from names, from own files, and from a job."""

import shutil

import numpy as np
import pytest
import trimesh

from simgen.config.job import load_job
from simgen.errors import InputError
from simgen.sensors.sensor_geometry import sensor_folder
from simgen.view.live_setup import FIRST_INDENTER, LiveSetup


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    """A folder with a copy of the GelSight Mini and a ball, 6 mm across, in mm."""
    folder = tmp_path_factory.mktemp("own")
    shutil.copytree(sensor_folder("gelsight_mini"), folder / "pad")
    trimesh.creation.icosphere(subdivisions=2, radius=3.0).export(folder / "ball.stl")
    return folder


def test_names_of_the_package():
    setup = LiveSetup.of(["digit"], None, None, None)
    assert list(setup.sensors) == list(setup.materials) == list(setup.surfaces) == list(setup.pictures) == ["digit"]
    assert list(setup.indenters) == [FIRST_INDENTER] and setup.base.sensors["digit"].mesh == "coarse"
    mesh, surface = setup.sensors["digit"].output_mesh, setup.surfaces["digit"]
    np.testing.assert_array_equal(surface.rest_mm, np.float32(1e3 * mesh.vertices[surface.vertices]))
    assert setup.materials["digit"] == setup.sensors["digit"].materials["solid"]
    assert setup.base.outputs == {"digit": ("traction",)} and not setup.pictures["digit"].why_not


def test_an_own_sensor_and_an_own_indenter(own, monkeypatch):
    monkeypatch.chdir(own)
    setup = LiveSetup.of(["./pad"], "./ball.stl", "mm", None)
    assert list(setup.sensors) == ["pad"] and setup.base.sensors["pad"].model == str(own / "pad")
    np.testing.assert_allclose(np.ptp(setup.indenters["ball"].vertices_mm, axis=0), 6.0, atol=0.05)
    assert setup.pictures["pad"].picture(None).ndim == 3


def test_a_job_brings_its_sensors_indenters_and_materials(own):
    (own / "own.yaml").write_text(
        "name: own\n"
        "sensors:\n"
        "  mine: {model: ./pad, material: {youngs_modulus_pa: 123e3}}\n"
        "  other: {model: biotac, mesh: coarse, material: effective}\n"
        "indenters: [ring_7mm, {file: ./ball.stl, unit: mm}]\n"
        "trajectories: {count: 5}\n"
        "depths_mm: {first: 0.2, last: 0.4, count: 2}\n"
    )
    setup = LiveSetup.of([], None, None, str(own / "own.yaml"))
    assert list(setup.sensors) == ["mine", "other"] and list(setup.indenters) == ["ring_7mm", "ball"]
    assert setup.materials["mine"].youngs_modulus_pa == 123e3
    assert setup.materials["other"] == setup.sensors["other"].materials["effective"]
    assert setup.base.depths_mm == load_job(own / "own.yaml").depths_mm
    assert "has no camera" in setup.pictures["other"].why_not


@pytest.mark.parametrize(
    "given, words",
    [
        ((["finger"], None, None, None), r"sensor 'finger': allowed: biotac, digit"),
        ((["./finger"], None, None, None), r"finger': allowed: biotac, digit.* or a folder with a sensor\.yaml"),
        ((["digit"], "needle", None, None), r"no indenter 'needle'; allowed: sphere_3\.5mm"),
        ((["digit"], "./none.stl", "mm", None), r"none\.stl"),
        (([], None, None, "nothing.yaml"), r"nothing\.yaml: no such job file"),
    ],
)
def test_what_is_not_there_is_one_sentence(given, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=words) as raised:
        LiveSetup.of(*given)
    assert "\n" not in str(raised.value)
