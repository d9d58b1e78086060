"""Stress and contact traction at a surface: exact values, datasets and exports."""

import csv
import shutil
from dataclasses import replace

import fake
import numpy as np
import pytest
import pyvista

from simgen import load_dataset
from simgen.config.job import job_from_dict
from simgen.dataset.audit import check, passes
from simgen.dataset.exchange.paraview import export_vtk
from simgen.dataset.exchange.selection import select, untracked
from simgen.dataset.exchange.training_arrays import export_npy
from simgen.dataset.reader import Dataset
from simgen.errors import InputError
from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from simgen.geometry.tetrahedra import OutputMesh
from simgen.pipeline.plan import make_plan
from simgen.pipeline.run import run
from simgen.sensors.sensor import Material
from simgen.simulation.press import Scene, press
from simgen.verification.validate.layer_press import LayerMeshSize, quarter_layer

LAYER = LayerMeshSize(edge=0.15, until=2.2, growth=0.4, top=0.25)


@pytest.fixture(scope="module")
def pressed_layer():
    """Scene and press of a sphere, R = 3.5 mm, 0.5 mm deep into a quarter of a bonded layer without friction."""
    layer = quarter_layer(LAYER, np.zeros(1))
    mesh = layer.simulation_mesh
    top = np.unique(mesh.touchable[:, :3])
    triangles = np.searchsorted(top, mesh.touchable[:, :3]).astype(np.int32)
    output = OutputMesh(mesh.nodes[top], np.zeros((0, 4), np.int32), triangles, np.zeros(len(top), bool),
                        np.ones(len(top), bool), "top")  # fmt: skip
    material = Material(youngs_modulus_pa=539e3, poisson_ratio=0.499, friction=0.0)
    scene = Scene(replace(layer, output_mesh=output), material, outputs=("stress", "traction"))
    return scene, press(scene, [rigid_shape(Kind.SPHERE, 3.5)], np.eye(4)[None], 1e-4 * np.arange(1, 6))[0]


def test_tractions_add_up_to_the_force(pressed_layer):
    """Tractions at corners times their shares of the faces' area sum to the force."""
    scene, result = pressed_layer
    total = np.einsum("dvi,v->di", result.traction, 1e-6 * scene.indenter_contact.corner_areas)
    np.testing.assert_allclose(total, result.force, atol=1e-6 * result.force[-1, 1])


def test_pressure_in_the_middle_of_a_layer(pressed_layer, reference):
    """Compare traction and stress with an independent axisymmetric solution."""
    scene, result = pressed_layer
    output = scene.sensor.output_mesh
    with open(reference / "axisymmetric" / "force.csv") as table:
        known = {(row["layer_radius_mm"], row["layer_height_mm"], row["friction"], row["depth_mm"]): row
                 for row in csv.DictReader(table) if row["sphere_radius_mm"] == "3.5"}  # fmt: skip
    pressure = 1e6 * float(known["10.0", "4.0", "0.0", "0.5"]["pressure_centre_mpa"])
    middle = np.linalg.norm(output.vertices[:, [0, 2]], axis=1).argmin()
    sigma, traction = result.stress[-1, middle], result.traction[-1, middle]
    ring = np.argsort(np.linalg.norm(output.vertices[:, [0, 2]], axis=1))[1]
    moved = output.vertices + result.displacement[-1]
    stretch = np.linalg.norm(moved[ring, [0, 2]]) / np.linalg.norm(output.vertices[ring, [0, 2]])
    print(f"reference {pressure:.0f}, traction {traction[1]:.0f}, sigma_yy {sigma[1]:.0f} Pa, stretch {stretch:.4f}")
    assert traction[1] == pytest.approx(pressure, rel=0.01)  # per rest area, both
    assert -sigma[1] * stretch**2 == pytest.approx(pressure, rel=0.01)  # the area grows with the square of the stretch


def test_what_nothing_touches_carries_no_traction(pressed_layer):
    scene, result = pressed_layer
    output = scene.sensor.output_mesh
    far = np.linalg.norm(output.vertices[:, [0, 2]], axis=1) > 3e-3
    assert not result.traction[:, far].any()
    normal_stress = np.abs(result.stress[-1, far, 1]).max()
    assert normal_stress < 0.02 * np.abs(result.stress[-1, :, 1]).max()  # a free surface


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    job = job_from_dict({
        "name": "surface", "seed": 5,
        "sensors": {"digit": {"model": "digit", "mesh": "coarse"}},
        "indenters": ["sphere_7mm"], "trajectories": {"count": 2},
        "depths_mm": {"first": 0.2, "last": 0.4, "count": 2},
        "outputs": {"digit": ["traction", "stress"]},
    })  # fmt: skip
    return run(make_plan(job), tmp_path_factory.mktemp("surface") / "surface.zarr")


def test_a_dataset_holds_what_its_job_asks_for(dataset):
    assert passes(check(dataset)), [finding for finding in check(dataset) if finding.failed]
    vertices = dataset["digit/surface_vertices"]
    np.testing.assert_array_equal(vertices, np.unique(dataset["digit/surface_triangles"]))
    for name, components in (("stress", 6), ("traction", 3)):
        stored = dataset.array(f"digit/{name}")
        assert stored.shape == (2, 2, len(vertices), components) and stored.attrs["unit"] == "Pa"
    assert "slip_share" not in dataset.root["digit"]


def test_samples_and_exports_have_it(dataset, tmp_path):
    sample = load_dataset(dataset.path)[1]
    assert sample["digit/traction"].dtype == np.float32
    touched = np.linalg.norm(sample["digit/traction"], axis=1)
    deepest = dataset["digit/surface_vertices"][touched.argmax()]
    contact = dataset["press/contact_pose"][0, :3, 3]
    assert np.linalg.norm(dataset["digit/rest_positions"][deepest] - contact) < 2e-3
    for name in ("npy", "vtk"):
        (tmp_path / name).mkdir()
    export_npy(select(dataset), tmp_path / "npy", untracked)
    np.testing.assert_array_equal(np.load(tmp_path / "npy/digit/stress.npy")[1], sample["digit/stress"])
    assert len(np.load(tmp_path / "npy/digit/surface_vertices.npy")) == len(touched)
    export_vtk(select(dataset, trajectories="0"), tmp_path / "vtk", untracked)
    mesh = pyvista.read(tmp_path / "vtk/trajectory_0/sphere_7mm/digit/depth_1.vtu")
    on_surface = dataset["digit/surface_vertices"]
    np.testing.assert_array_equal(mesh.point_data["traction_Pa"][on_surface], sample["digit/traction"])


def test_a_number_that_is_missing_is_found(dataset, tmp_path):
    copy = tmp_path / "copy.zarr"
    shutil.copytree(dataset.path, copy)
    fake.change(Dataset(copy), "digit/stress", (1, 0, 5, 2), np.nan)
    (found,) = (finding for finding in check(Dataset(copy)) if finding.failed)
    assert found.what == "stress gaps" and found.bad == ((1, 0),)


def test_the_order_of_outputs_is_no_other_job():
    one, other, none = (fake.make_job(outputs=outputs) for outputs in
                        ({"digit": ["stress", "traction"]}, {"digit": ["traction", "stress", "stress"]}, {"digit": []}))
    assert one.hash == other.hash and none.hash == fake.make_job().hash


def test_vertices_below_the_surface_have_the_traction_above_them(pressed_layer):
    """Vertices of a user's mesh may lie a little inside the gel, where corners carry no traction."""
    scene, result = pressed_layer
    below = scene.sensor.output_mesh.vertices + np.array([0.0, 0.03e-3, 0.0])
    output = replace(scene.sensor.output_mesh, vertices=below)
    inside = Scene(replace(scene.sensor, output_mesh=output), scene.material, outputs=("traction",))
    again = press(inside, [rigid_shape(Kind.SPHERE, 3.5)], np.eye(4)[None], 1e-4 * np.arange(1, 3))[0]
    largest = np.abs(result.traction[1]).max()
    np.testing.assert_allclose(again.traction[1], result.traction[1], atol=0.03 * largest)


def test_outputs_that_are_not_there_are_refused():
    for outputs, told in (({"finger": ["stress"]}, "no sensor of the job"), ({"digit": ["heat"]}, "allowed")):
        with pytest.raises(InputError, match=told):
            fake.make_job(outputs=outputs)
