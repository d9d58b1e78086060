"""Remarks on output meshes too coarse for the camera, from the shapes pressed and the pixels that see them."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
import yaml
from refusal import simgen

from simgen.config.job import load_job
from simgen.pipeline.image_resolution import coarse_images, contact_radius, pixel, touched_edge
from simgen.pipeline.plan import chosen_sensor, make_plan
from simgen.sensors.indenter import load_indenter
from simgen.sensors.sensor import Camera, place_camera
from simgen.sensors.sensor_schema import CameraSettings

CAMERA = {
    "position_mm": [0.0, 17.0, 0.0],
    "looks_along": [0.0, -1.0, 0.0],
    "up": [-1.0, 0.0, 0.0],
    "vertical_field_of_view_deg": 60.0,
    "width_px": 240,
    "height_px": 320,
    "light_circle_radius_mm": 20.0,
    "light_angles_deg": {"red": 30.0, "green": 150.0, "blue": 270.0},
}


@pytest.mark.parametrize("depth_mm", [0.1, 0.6, 1.5])
def test_the_contact_of_a_sphere_is_its_cap(depth_mm, tmp_path):
    """Radius sqrt(2 R d - d^2), to a cell of the grid; a mesh in mm has it, too."""
    trimesh.creation.icosphere(subdivisions=5, radius=3.5).export(tmp_path / "ball.stl")
    exact = 1e-3 * np.sqrt(7.0 * depth_mm - depth_mm**2)
    for indenter in (load_indenter("sphere_7mm"), load_indenter(tmp_path / "ball.stl", unit="mm")):
        assert contact_radius(indenter, 1e-3 * depth_mm) == pytest.approx(exact, abs=0.036e-3)


def test_a_body_that_is_thinner_than_the_depth_has_its_own_width(tmp_path):
    """A bar of 4 x 0.4 x 1 mm, lying, at 0.6 mm."""
    trimesh.creation.box([4.0, 0.4, 1.0]).export(tmp_path / "bar.stl")
    bar = load_indenter(tmp_path / "bar.stl", unit="mm")
    assert contact_radius(bar, 0.6e-3) == pytest.approx(0.5e-3, abs=0.02e-3)


def test_the_contact_of_a_ring_is_as_wide_as_its_wall():
    assert contact_radius(load_indenter("ring_7mm"), 1e-3) == pytest.approx(1.75e-3, abs=0.07e-3)


def flat(edge_mm: float, **camera) -> tuple[SimpleNamespace, Camera]:
    """A flat sensor with triangles whose legs are so long, and its camera, 20 mm before it."""
    count = round(20.0 / edge_mm)
    line = np.linspace(-0.5e-3 * count * edge_mm, 0.5e-3 * count * edge_mm, count + 1)
    x, z = (each.ravel() for each in np.meshgrid(line, line, indexing="ij"))
    corner = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).ravel()
    triangles = np.stack([corner, corner + 1, corner + count + 1], axis=1)
    vertices = np.column_stack([x, np.full(len(x), -3e-3), z])
    mesh = SimpleNamespace(vertices=vertices, surface_triangles=triangles, touchable=np.ones(len(x), bool))
    settings = CameraSettings.model_validate_json(json.dumps({**CAMERA, **camera}))
    return SimpleNamespace(output_mesh=mesh), place_camera(settings)


def test_edges_and_pixels_are_measured():
    sensor, camera = flat(0.5)
    assert touched_edge(sensor.output_mesh) == pytest.approx(0.5e-3)
    assert pixel(camera, sensor.output_mesh) == pytest.approx(2 * 0.02 * np.tan(np.pi / 6) / 320)


def test_the_smallest_contact_decides_and_what_is_proposed_will_do():
    indenters = [load_indenter("cube_14mm"), load_indenter("sphere_3.5mm")]
    (remark,) = coarse_images("slab", *flat(1.5), indenters, 0.6e-3)
    assert "slab: images will hardly show sphere_3.5mm: at 0.6 mm its contact is 2.6 mm wide" in remark
    assert "edges of 1.5 mm" in remark and "{edge_length_mm: 0.53}" in remark
    assert coarse_images("slab", *flat(0.53), indenters, 0.6e-3) == []
    assert coarse_images("slab", *flat(1.5), indenters[:1], 0.6e-3) == []


def test_edges_within_a_pixel_are_fine_enough_and_no_camera_needs_none():
    indenters = [load_indenter("sphere_3.5mm")]
    assert coarse_images("slab", *flat(1.5, width_px=9, height_px=12), indenters, 0.6e-3) == []
    assert coarse_images("slab", flat(1.5)[0], None, indenters, 0.6e-3) == []


@pytest.fixture
def slab(tmp_path, monkeypatch):
    """A job on a slab with a camera, whose sensor.yaml says nothing of output; a function that makes it say so."""
    monkeypatch.setenv("SIMGEN_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    trimesh.creation.box([14.0, 3.0, 14.0]).export(tmp_path / "slab.stl")
    job = {
        "name": "own",
        "sensors": {"slab": {"model": "./"}},
        "indenters": ["sphere_7mm"],
        "trajectories": {"count": 1},
        "depths_mm": {"first": 0.3, "last": 0.6, "count": 2},
    }
    (tmp_path / "job.yaml").write_text(yaml.safe_dump(job))

    def describe(**meshes) -> None:
        about = {
            "name": "slab",
            "gel": {"mesh": {"file": "slab.stl", "unit": "mm"}},
            "held": {"back": {"plane": {"axis": "y", "at_mm": 1.5}}},
            "meshes": {"default": {"edge_length_mm": 1.5}, **meshes},
            "materials": {"solid": {"youngs_modulus_pa": 539e3, "poisson_ratio": 0.499, "friction": 0.78}},
            "cameras": {"default": CAMERA},
        }
        (tmp_path / "sensor.yaml").write_text(yaml.safe_dump(about))

    return describe


def test_a_slab_without_an_output_mesh_is_remarked_on_before_it_is_pressed(slab, monkeypatch, capfd):
    slab()
    remarks = make_plan(load_job("job.yaml")).remarks
    assert len(remarks) == 1 and "slab: images will hardly show sphere_7mm: at 0.6 mm" in remarks[0]
    code, printed, _ = simgen("run job.yaml --dry-run", monkeypatch, capfd)
    assert code == 0 and remarks[0] in printed
    slab(output={"edge_length_mm": 0.78, "held_edge_length_mm": 1.5})  # as the remark proposes
    assert "edge_length_mm: 0.78}" in remarks[0]
    assert make_plan(load_job("job.yaml")).remarks == []


@pytest.mark.parametrize("job", ["smoke", "paired", "tiny_pairs"])
def test_the_bundled_jobs_suit_the_bundled_camera(job):
    job = load_job(job)
    indenters, digit = [load_indenter(name) for name in job.indenter_names], chosen_sensor(job, "digit")
    assert coarse_images("digit", digit, digit.cameras["default"], indenters, job.depths_m[-1]) == []
