"""A rigid sphere on a bonded, near-incompressible layer, as a user's own sensor, against independent solutions."""

import csv

import meshio
import numpy as np
import pytest
import trimesh

from simgen.geometry.tetrahedra import tetrahedralize
from simgen.sensors.indenter import load_indenter
from simgen.sensors.sensor import load_sensor
from simgen.simulation.press import Scene, press

SENSOR = """
name: layer
gel: {mesh: {file: layer.vtu, unit: mm}}
held:
  bottom: {plane: {axis: y, at_mm: 4.0, within_mm: 0.001}}
meshes:
  default: as_given
materials:
  solid: {youngs_modulus_pa: 539.0e+3, poisson_ratio: 0.499, friction: 0.78, source: Smooth-On Solaris}
"""
FINE_MM, COARSE_MM, FINE_RADIUS_MM = 0.5, 3.0, 2.5  # edges under the sphere and far from it


def edge_length(points_mm):
    distance = np.hypot(points_mm[:, 0], points_mm[:, 2]) + 0.5 * points_mm[:, 1]
    return np.clip(FINE_MM + (COARSE_MM - FINE_MM) * (distance - FINE_RADIUS_MM) / 5.0, FINE_MM, COARSE_MM)


@pytest.fixture(scope="session")
def layer(tmp_path_factory):
    """A cylinder of radius 10 mm and height 4 mm, its top at y = 0 facing -y, its bottom bonded."""
    folder = tmp_path_factory.mktemp("layer")
    (folder / "sensor.yaml").write_text(SENSOR)
    cylinder = trimesh.creation.cylinder(radius=10.0, height=4.0, sections=96)
    cylinder.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2.0, [1.0, 0.0, 0.0]))
    cylinder.apply_translation([0.0, 2.0, 0.0])
    vertices, tetrahedra = tetrahedralize(cylinder, edge_length, envelope=0.02, cell=1.0)
    for level in (0.0, 4.0):  # the mesher may move flat faces within its envelope
        vertices[np.abs(vertices[:, 1] - level) < 0.025, 1] = level
    meshio.Mesh(vertices, [("tetra", tetrahedra)]).write(folder / "layer.vtu")
    return load_sensor(folder)


def press_centre(layer, friction, depths_mm):
    material = layer.materials["solid"].model_copy(update={"friction": friction})
    scene = Scene(layer, material)
    result = press(scene, [load_indenter("sphere_7mm").shape()], np.eye(4)[None], depths_mm * 1e-3)[0]
    assert (result.status == 0).all()
    print(f"{scene.unknowns} unknowns, {result.seconds:.0f} s, force {result.force[:, 1].round(4)} N")
    return result


def forces(reference, friction, steps, depths):
    with open(reference / "axisymmetric" / "force.csv") as table:
        rows = [row for row in csv.DictReader(table) if row["sphere_radius_mm"] == "3.5"]
    wanted = {("layer_radius_mm", 10.0), ("layer_height_mm", 4.0), ("friction", friction), ("load_steps_to_2mm", steps)}
    rows = [row for row in rows if all(float(row[key]) == value for key, value in wanted)]
    return [float(next(row["force_n"] for row in rows if float(row["depth_mm"]) == d)) for d in depths]


def test_force_without_friction_within_one_percent(layer, reference):
    depths = np.linspace(0.1, 1.0, 10)
    result = press_centre(layer, 0.0, depths)
    expected = forces(reference, 0.0, 20, [0.5, 1.0])
    # The project's target; the mesh error measured at this size is +0.3 to +0.5 %.
    np.testing.assert_allclose(result.force[[4, 9], 1], expected, rtol=0.01)
    assert (result.certificate["force_balance"] < 1e-3).all()


def test_force_with_friction_within_one_percent(layer, reference):
    depths = np.linspace(0.1, 1.0, 10)
    result = press_centre(layer, 0.78, depths)
    # The reference counts slip from the start of a step. So its force falls by 0.7 % as its load step goes from 0.1 to
    # 0.0125 mm. Ours counts slip from the point's entry, and must meet the smallest steps, with the same target of 1 %.
    # Forces over those without friction, so that the error of this coarse mesh, 0.5 % at 1 mm, cancels.
    plain = press_centre(layer, 0.0, depths)
    expected = np.array(forces(reference, 0.78, 160, [0.5, 1.0])) / forces(reference, 0.0, 20, [0.5, 1.0])
    found = result.force[[4, 9], 1] / plain.force[[4, 9], 1]
    print("friction raises the force by", found.round(4), "reference", expected.round(4))
    np.testing.assert_allclose(found, expected, rtol=0.01)
