"""The support of a gel: exact distances, exact compression, a rim that no longer hangs below its plate, bad input."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import trimesh
import yaml

from simgen.config.job import job_from_dict
from simgen.errors import InputError
from simgen.fem.device import Reading
from simgen.fem.nonlinear.status import has_values
from simgen.geometry.rigid_shape import mesh_distance, rigid_shape, signed_distance
from simgen.geometry.signed_distance import Kind
from simgen.pipeline.plan import sensor_identity
from simgen.sensors.indenter import load_indenter
from simgen.sensors.sensor import Material, load_sensor
from simgen.sensors.sensor_schema import SupportPlane
from simgen.sensors.support import THICKNESS_MM, Plate, Support, distance_to_outline, faces_in_reach, plate_under
from simgen.simulation.batch_size import bytes_per_press
from simgen.simulation.press import Scene, SolverSettings, Status, press
from simgen.units import MM
from simgen.verification.validate.hard_scenes import GEL, block
from simgen.verification.validate.layer_meshes import make_sensor
from simgen.verification.validate.meshes import box, on_plane
from simgen.verification.validate.reference_law import ReferenceLaw
from simgen.verification.validate.sensors import place_indenter

PLATE_Y_MM = -4.2365  # the DIGIT's


def square(half_mm: float, at_mm: float, beyond_mm: float) -> Plate:
    """A plate across y under a gel with a square outline; the gel lies towards -y."""
    corners = half_mm * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return Plate(1, at_mm, -1, np.stack([corners, np.roll(corners, -1, axis=0)], axis=1), beyond_mm)


@pytest.fixture(scope="module")
def digit():
    return load_sensor("digit", "coarse")


def without(sensor):
    return replace(sensor, support=None)


# The plate


def test_distance_of_a_plate_is_that_of_a_box():
    """Without a margin the plate under a square is a box; with one its corners are round."""
    points = np.random.default_rng(1).uniform(-9.0, 9.0, (500, 3))
    body = trimesh.creation.box(np.array([8.0, THICKNESS_MM, 8.0]) * MM)
    body.apply_translation([0.0, (2.0 + THICKNESS_MM / 2.0) * MM, 0.0])
    np.testing.assert_allclose(square(4.0, 2.0, 0.0).distance(points), mesh_distance(body, points), atol=1e-5)
    corner = np.array([[7.0, 3.0, 8.0]])  # 3 and 4 mm beyond the square's corner, beside the plate
    assert square(4.0, 2.0, 1.5).distance(corner)[0] == pytest.approx(5.0 - 1.5)


def test_a_ring_of_gel_rests_on_a_ring():
    outer, inner = square(4.0, 0.0, 0.0).outline_mm, square(2.0, 0.0, 0.0).outline_mm
    ring = Plate(1, 0.0, -1, np.concatenate([outer, inner]), 0.5)
    found = ring.distance(np.array([[0.0, 1.0, 0.0], [3.0, 1.0, 0.0], [3.0, -1.0, 0.0]]))
    np.testing.assert_allclose(found, [1.5, -1.0, 1.0])


def test_the_sampled_plate_is_exact_near_its_face():
    """Cubic splines ring at a kink; six cells from the plate's edge less than 0.1 um is left."""
    plate = square(4.0, 2.0, 2.0)
    points = np.random.default_rng(2).uniform([-4.5, 0.0, -4.5], [4.5, 2.1, 4.5], (2000, 3))
    found = signed_distance(Support(plate, None, "").shape("cpu"), points)[0]
    np.testing.assert_allclose(found, plate.distance(points), atol=1e-4)


def test_the_digits_plate_goes_on_in_the_plane_of_its_bond(digit):
    plate = digit.support.body
    bonded = digit.simulation_mesh.nodes[digit.simulation_mesh.held]
    np.testing.assert_allclose(digit.support.distance(bonded), 0.0, atol=1e-6)
    assert digit.support.distance(digit.simulation_mesh.nodes).min() > -1e-6  # all of the gel lies above it
    gel = digit.surface.bounds / MM
    np.testing.assert_allclose(plate.bounds_mm[:, [0, 2]], gel[:, [0, 2]] + [[-2.8], [2.8]], atol=1e-6)
    np.testing.assert_allclose(plate.bounds_mm[:, 1], [PLATE_Y_MM, PLATE_Y_MM + THICKNESS_MM])


def test_either_side_and_any_axis():
    gel = trimesh.creation.box([4.0 * MM, 6.0 * MM, 8.0 * MM])
    for axis, half in zip("xyz", (2.0, 3.0, 4.0), strict=True):
        for side in (-1.0, 1.0):
            plate = plate_under(gel, SupportPlane(axis=axis, at_mm=side * half, beyond_outline_mm=1.0), "sensor.yaml")
            expected = np.array([[-3.0, -4.0, -5.0], [3.0, 4.0, 5.0]])
            expected[:, "xyz".index(axis)] = sorted([side * half, side * (half + THICKNESS_MM)])
            np.testing.assert_allclose(plate.bounds_mm, expected, atol=1e-9)


def test_faces_that_can_reach_it_lie_around_the_bond(digit):
    """Wall, rim and the beginning of the dome; not what lies over the middle of a bond, however thin the gel."""
    mesh = digit.simulation_mesh
    faces = faces_in_reach(digit.support, mesh)
    inside = mesh.nodes[faces].mean(axis=1)[:, [0, 2]] / MM
    assert (np.abs(inside - [-7.5, 0.0]) > [7.0, 6.0]).any(axis=1).all()
    wall = (mesh.nodes[mesh.touchable][:, :3, 1] / MM > PLATE_Y_MM - 1.5).any(axis=1)
    assert {*map(tuple, mesh.touchable[wall])} <= {*map(tuple, faces)}
    thin = block(box((8, 2, 8), (10.0, 1.0, 10.0)))
    faces = faces_in_reach(Support(square(5.0, 1.0, 1.0), None, ""), thin.simulation_mesh)
    middle = np.abs(thin.simulation_mesh.nodes[faces].mean(axis=1)[:, [0, 2]]).max(axis=1) / MM
    assert middle.min() > 3.0  # REACH times a height of 1 mm, and a face, from the outline at 5 mm


# Presses


def test_a_block_between_two_planes_follows_the_closed_form():
    """Uniaxial compression by a fifth: nothing is bonded, a symmetry plane and one node keep the block in place."""
    size, stretch = 3.0, 0.8
    mesh = box((2, 2, 2), (size, size, size))
    corner = mesh.nodes.min(axis=0)
    held = np.stack([on_plane(mesh.nodes, 0, corner[0]), np.zeros(len(mesh.nodes), bool),
                     on_plane(mesh.nodes, 2, corner[2])], axis=1)  # fmt: skip
    bottom = mesh.nodes[:, 1].max()
    held[np.argmin(np.linalg.norm(mesh.nodes - [corner[0], bottom, corner[2]], axis=1)), 1] = True
    plate = replace(square(size, bottom, 2.0), outline_mm=square(size, 0.0, 0.0).outline_mm)
    # Top and bottom alone: a multiplier on their edges would press on the sides, too.
    level = mesh.faces[np.ptp(mesh.nodes[mesh.faces][:, :, 1], axis=1) < 1e-9]
    sensor = make_sensor(mesh, held, level, mesh.nodes[: mesh.n_corners])
    sensor = replace(sensor, support=Support(plate, 0.0, ""))
    smooth = Material(**{**GEL.model_dump(), "friction": 0.0})
    scene = Scene(sensor, smooth, settings=SolverSettings(residual_tolerance=1e-4, contact_tolerance=1e-3))
    pose = np.eye(4)
    pose[:3, 3] = [0.0, (mesh.nodes[:, 1].min() - 0.5) * MM, 0.0]
    found = press(scene, [rigid_shape(Kind.CUBE, 7.0, 1.0)], pose[None], np.array([0.1, 0.2]) * size * MM)[0]
    assert (found.status == Status.CONVERGED).all()
    stress, lateral = ReferenceLaw(smooth.poisson_ratio).uniaxial(stretch)
    expected = -stress * smooth.youngs_modulus_pa * (size * MM) ** 2
    assert found.force[-1, 1] == pytest.approx(expected, rel=1e-4)
    u, rest = found.displacement[-1] / MM, sensor.output_mesh.vertices / MM
    np.testing.assert_allclose(u[:, 1], (stretch - 1.0) * (rest[:, 1] - bottom), atol=1e-4)
    np.testing.assert_allclose(u[:, 0], (lateral - 1.0) * (rest[:, 0] - corner[0]), atol=1e-4)
    on_plate = scene.support_contact.resultants(scene.solver.x).read().force[0]
    pressed = scene.indenter_contact.resultants(scene.solver.x).read().force[0]
    np.testing.assert_allclose(on_plate, -pressed, atol=1e-3 * pressed[1])


@pytest.fixture(scope="module")
def at_the_rim(digit):
    """A cube that is pressed 1.2 mm into the DIGIT's long side, without and with its plate: scene and result.

    Elements may turn inside out here: on this coarse mesh those that are kept open hold back what bulges over the bond.
    """
    pose, depths = place_indenter(digit, -3.0, -6.0)[None], np.linspace(0.1, 1.2, 12) * MM
    found = []
    for sensor in (without(digit), digit):
        scene = Scene(sensor, digit.materials["solid"])
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(scene.solver.elasticity, "expect", lambda x: None)
            patch.setattr(scene.solver.elasticity, "stabilise", lambda x: Reading((), lambda: np.zeros(1)))
            found.append((scene, press(scene, [load_indenter("cube_14mm").shape()], pose, depths)[0]))
    return found


def below_plate_mm(scene) -> float:
    nodes = scene.nodes + scene.solver.x.numpy()[: scene.nodes.size, 0].reshape(-1, 3)
    return nodes[:, 1].max() - PLATE_Y_MM


def test_gel_that_bulges_over_its_bond_rests_on_the_plate(at_the_rim):
    (bare_scene, bare), (scene, found) = at_the_rim
    assert has_values(bare.status).all() and has_values(found.status).all()
    assert below_plate_mm(bare_scene) > 0.3
    # The overlap that a sample may have is a quarter of a face's edge; beside the bond it is a twentieth.
    assert below_plate_mm(scene) < 0.06 * scene.support_contact.edge
    assert (found.certificate["force_balance"] < 1e-3).all()
    on_plate = scene.support_contact.resultants(scene.solver.x).read()
    assert on_plate.force[0, 1] < -0.1 and scene.support_contact.friction == scene.material.friction
    unbalanced = np.linalg.norm(on_plate.force[0]) * scene.material.youngs_modulus_pa / 1e6
    assert unbalanced > 5e-3 * np.linalg.norm(found.force[-1])  # five times what the balance may be off by


def test_the_plate_costs_no_linear_iterations(at_the_rim):
    each = []
    for _, found in at_the_rim:
        krylov, newton = (found.certificate[f"{kind}_iterations"].sum() for kind in ("krylov", "newton"))
        each.append(krylov / newton)
    assert each[1] < 1.1 * each[0]


def test_a_press_that_does_not_reach_the_plate_keeps_its_force(digit):
    pose, depths = place_indenter(digit, -7.5, 0.0)[None], np.array([0.5e-3, 1e-3])
    scenes = [Scene(sensor, digit.materials["solid"]) for sensor in (without(digit), digit)]
    bare, found = (press(scene, [load_indenter("sphere_7mm").shape()], pose, depths)[0] for scene in scenes)
    np.testing.assert_allclose(found.force, bare.force, rtol=0.0, atol=5e-4 * np.linalg.norm(bare.force[-1]))


def test_gel_slides_on_a_smooth_plate(digit, at_the_rim):
    smooth = replace(digit, support=replace(digit.support, friction=0.0))
    scene = Scene(smooth, digit.materials["solid"])
    pose, depths = place_indenter(digit, -3.0, -6.0)[None], np.linspace(0.1, 1.2, 12) * MM
    press(scene, [load_indenter("cube_14mm").shape()], pose, depths)
    scenes = scene, at_the_rim[1][0]
    force, rough = (each.support_contact.resultants(each.solver.x).read().force[0] for each in scenes)
    assert np.hypot(force[0], force[2]) < 1e-3 * abs(force[1]) < np.hypot(rough[0], rough[2])


# What knows of it


def test_scene_memory_and_identity_know_the_support(digit):
    carried = {name: (yes, why) for name, yes, why in Scene(digit, digit.materials["solid"]).terms}
    assert carried["support contact"][0] and carried["support friction"] == (True, "Coulomb coefficient 0.78")
    bare = {name: yes for name, yes, _ in Scene(without(digit), digit.materials["solid"]).terms}
    assert not bare["support contact"] and not bare["support friction"]
    assert bytes_per_press(digit) > bytes_per_press(without(digit))
    depths = {"first": 0.1, "last": 0.2, "count": 2}
    job = job_from_dict({"name": "j", "sensors": {"digit": {"model": "digit"}}, "indenters": ["sphere_7mm"],
                         "trajectories": {"count": 1}, "depths_mm": depths})  # fmt: skip
    assert sensor_identity(job, "digit", digit)["support"] == digit.support.source
    assert "support" not in sensor_identity(job, "digit", without(digit))


# A user's own


def slab(folder, **support):
    """A slab of 20 x 4 x 20 mm whose back is bonded."""
    folder.mkdir(exist_ok=True)
    trimesh.creation.box([20.0, 4.0, 20.0]).export(folder / "slab.stl")
    description = {
        "name": "slab",
        "gel": {"mesh": {"file": "slab.stl", "unit": "mm"}},
        "held": {"back": {"plane": {"axis": "y", "at_mm": 2.0}}},
        "support": support,
        "meshes": {"default": {"edge_length_mm": 4.0}},
        "materials": {"solid": GEL.model_dump()},
    }
    (folder / "sensor.yaml").write_text(yaml.safe_dump(description))
    return folder


def table(folder, y_mm=2.0):
    body = trimesh.creation.box([26.0, THICKNESS_MM, 26.0])
    body.apply_translation([0.0, y_mm + THICKNESS_MM / 2.0, 0.0])
    body.export(folder / "table.stl")


def test_a_support_is_sampled_once(digit):
    assert digit.support.shape("cpu") is digit.support.shape("cpu")
    assert replace(digit.support, source="another").shape("cpu") is not digit.support.shape("cpu")


def test_a_slab_may_rest_on_a_plane_or_on_a_mesh(tmp_path, own_cache):
    plane = load_sensor(slab(tmp_path / "a", plane={"axis": "y", "at_mm": 2.0}, friction=0.3))
    assert plane.support.friction == 0.3 and plane.support.body.beyond_mm == 3.0
    folder = slab(tmp_path / "b", mesh={"file": "table.stl", "unit": "mm"})
    table(folder)
    mesh = load_sensor(folder)
    assert mesh.support.friction is None and mesh.support.source != plane.support.source
    np.testing.assert_array_equal(
        faces_in_reach(mesh.support, mesh.simulation_mesh), faces_in_reach(plane.support, mesh.simulation_mesh)
    )
    points = np.random.default_rng(3).uniform(-9.0, 9.0, (200, 3))
    flat = [signed_distance(sensor.support.shape("cpu"), points)[0] for sensor in (plane, mesh)]
    np.testing.assert_allclose(flat[1], flat[0], atol=1e-4)
    source = mesh.support.source
    table(folder, y_mm=2.01)
    assert load_sensor(folder).support.source != source


@pytest.mark.parametrize(
    ("support", "line"),
    [
        ({}, "support: exactly one of plane, mesh is needed, found none"),
        ({"plane": {"axis": "y", "at_mm": 2.0}, "mesh": {"file": "slab.stl", "unit": "mm"}},
         "support: exactly one of plane, mesh is needed, found plane, mesh"),
        ({"plane": {"axis": "w", "at_mm": 2.0}}, 'support.plane.axis: "w" is not allowed; allowed: x, y or z'),
        ({"plane": {"axis": "y", "at_mm": 2.0, "beyond_outline_mm": -1.0}},
         "support.plane.beyond_outline_mm: -1.0 is not allowed; allowed: 0 to 20 mm"),
        ({"plane": {"axis": "y", "at_mm": 2.0, "beyond": 1.0}},
         "support.plane.beyond: unknown key; allowed: axis, at_mm, within_mm, beyond_outline_mm"),
        ({"plane": {"axis": "y", "at_mm": 2.0}, "friction": 3.0},
         "support.friction: 3.0 is not allowed; allowed: 0 to 2"),
        ({"plane": {"axis": "y", "at_mm": 1.0}},
         "support.plane.at_mm = 1: it cuts the gel; allowed: where the gel ends, y = -2 or 2"),
        ({"plane": {"axis": "y", "at_mm": 2.5}},
         "support.plane.at_mm = 2.5: no triangle of the gel lies within 0.01 mm of it; allowed: a flat end of the gel"),
        ({"plane": {"axis": "y", "at_mm": 2.0, "within_mm": 9.0}},
         "support.plane.within_mm = 9: all of the gel lies in it; allowed: less than the gel's height, 4"),
        ({"mesh": {"file": "gone.stl", "unit": "mm"}}, "gone.stl: no such mesh file"),
        ({"mesh": {"file": "table.stl", "unit": "mm"}},
         "support.mesh.file = 'table.stl': the free surface of the gel comes within 1 mm of it (negative: inside); "
         "allowed: -0.05 to 0.05 mm"),
    ],
)  # fmt: skip
def test_what_no_gel_rests_on_is_one_line(tmp_path, own_cache, support, line):
    folder = slab(tmp_path / "s", **support)
    table(folder, y_mm=3.0)
    with pytest.raises(InputError) as refusal:
        load_sensor(folder)
    assert line in str(refusal.value) and "\n" not in str(refusal.value)
    assert str(folder) in str(refusal.value)


def test_meshes_do_not_depend_on_the_support(tmp_path, own_cache):
    """So the bundled meshes, and those that users have made, stay."""
    folder = slab(tmp_path / "s", plane={"axis": "y", "at_mm": 2.0})
    first = load_sensor(folder).simulation_mesh.hash
    other = slab(tmp_path / "t", plane={"axis": "y", "at_mm": 2.0, "beyond_outline_mm": 1.0}, friction=0.1)
    shutil.copy(folder / "slab.stl", other)
    assert load_sensor(other).simulation_mesh.hash == first


def test_an_edge_without_length_changes_no_distance():
    corners = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 0.0], [4.0, 2.0], [0.0, 2.0]])
    outline = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    found = distance_to_outline(np.array([[2.0, 0.5], [7.0, 6.0]]), outline)
    np.testing.assert_allclose(found, [-0.5, 5.0])
