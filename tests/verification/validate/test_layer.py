"""The layer of `simgen validate`: its meshes, its facts, and how a press on it is measured."""

import csv
import math
import pickle
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from simgen.fem.elements.element import P2P1, face_geometry, tet_geometry
from simgen.geometry.curved_tetrahedra import determinants
from simgen.geometry.interpolation import interpolation_matrix
from simgen.verification.validate import all_cases, layer_press
from simgen.verification.validate.case import Context
from simgen.verification.validate.layer import increments, reference_rows, solve_linear
from simgen.verification.validate.layer_meshes import graded, make_sensor, rings, round_layer
from simgen.verification.validate.layer_press import (
    AZIMUTHS,
    LayerMeshSize,
    LayerPress,
    contact_radius,
    press_layer,
    pressure_swing,
    quarter_layer,
    surface_error,
)
from simgen.verification.validate.layer_reference import (
    DEPTHS_MM,
    LINEAR,
    REFERENCES,
    dimitriadis_force,
    hertz_force,
    read_profiles,
)
from simgen.verification.validate.meshes import faces_on, on_plane, top

COARSE = LayerMeshSize(edge=0.8, until=1.0, growth=0.5, top=0.8)


def coarse_mesh(quarters=1):
    return round_layer(graded(10.0, 0.8, 1.0, 0.5), graded(4.0, 0.8, 0.8, 0.25), 3, quarters)


def test_graded_points_grow_steadily_from_the_fine_edge_to_the_end():
    r = graded(10.0, 0.25, 0.7, 0.1)
    spacing = np.diff(r)
    assert (r[0], r[-1]) == (0.0, pytest.approx(10.0, abs=1e-12))
    assert spacing[0] == pytest.approx(0.25, rel=0.05)
    assert (np.diff(spacing) > -1e-6).all()
    assert (spacing[1:] / spacing[:-1]).max() < 1.2
    # A spacing that grows by s per mm makes steps of ratio exp(s), but for the whole number of steps.
    np.testing.assert_allclose((spacing[1:] / spacing[:-1])[-4:], math.exp(0.1), rtol=5e-3)


@pytest.mark.parametrize("quarters", [1, 2])
def test_rings_cover_the_sector_once(quarters):
    points, triangles = rings(np.array([0.0, 1.0, 2.0, 3.5]), 3, quarters)
    a, b, c = (points[triangles[:, i]] for i in range(3))
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    assert (area < 0.0).all()  # seen from +y, from where z turns clockwise to x, all are counter-clockwise
    boundary = 0.5 * 3.5**2 * 3 * quarters * math.sin(math.pi / 6)  # triangles of the outer polygon
    assert -area.sum() == pytest.approx(boundary, rel=1e-12)
    on_ring = np.isclose(np.linalg.norm(points, axis=1), 3.5)
    assert on_ring.sum() == 3 * quarters + 1


@pytest.mark.parametrize("quarters", [1, 2])
def test_round_layer_is_round_and_smooth(quarters):
    mesh = coarse_mesh(quarters)
    volume = tet_geometry(P2P1, mesh.nodes, mesh.tetrahedra).volumes.sum()
    assert volume == pytest.approx(100.0 * math.pi * quarters, rel=1e-3)  # quadratic edges against arcs of 30 degrees
    assert face_geometry(P2P1, mesh.nodes, top(mesh.nodes, mesh.faces)).areas.sum() == pytest.approx(
        25.0 * math.pi * quarters, rel=1e-3
    )
    radius = np.hypot(mesh.nodes[:, 0], mesh.nodes[:, 2])
    side = faces_on(mesh.faces, np.isclose(radius, 10.0))
    assert face_geometry(P2P1, mesh.nodes, side).areas.sum() == pytest.approx(20.0 * math.pi * quarters, rel=1e-3)
    assert determinants(mesh.nodes, mesh.tetrahedra).min() > 0.8  # near 1: hardly distorted by their curved edges
    planes = 2 if quarters == 1 else 1
    faces = sum(len(faces_on(mesh.faces, on_plane(mesh.nodes, axis, 0.0))) for axis in (0, 2)[-planes:])
    levels = len(np.unique(mesh.nodes[: mesh.n_corners, 1])) - 1
    assert faces == 2 * 2 * levels * (len(graded(10.0, 0.8, 1.0, 0.5)) - 1)


def test_two_makings_are_the_same_mesh():
    np.testing.assert_array_equal(coarse_mesh().nodes, coarse_mesh().nodes)


def test_output_points_take_the_quadratic_field_of_the_mesh():
    mesh = coarse_mesh()
    points = np.array([[0.3, 0.0, 0.4], [2.0, 0.0, 0.0], [0.0, 0.0, 6.0]])
    sensor = make_sensor(mesh, np.zeros(len(mesh.nodes), dtype=bool), top(mesh.nodes, mesh.faces), points)
    body = sensor.simulation_mesh
    linear = interpolation_matrix(body, sensor.output_mesh.vertices) @ body.nodes
    np.testing.assert_allclose(linear, points * 1e-3, atol=1e-12)


def test_facts_are_those_of_the_reference_with_the_finest_load_steps(reference):
    with open(reference / "axisymmetric" / "force.csv", newline="") as table:
        rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(table)]
    pairs = {(row["sphere_radius_mm"], row["friction"]) for row in rows}
    assert pairs == set(REFERENCES)
    for (sphere, friction), facts in REFERENCES.items():
        own = [row for row in rows if (row["sphere_radius_mm"], row["friction"]) == (sphere, friction)]
        finest = max(row["load_steps_to_2mm"] for row in own)
        own = sorted((row for row in own if row["load_steps_to_2mm"] == finest), key=lambda row: row["depth_mm"])
        assert facts.steps == finest
        assert tuple(row["depth_mm"] for row in own) == DEPTHS_MM
        assert tuple(row["force_n"] for row in own) == facts.force
        assert tuple(row["contact_radius_mm"] for row in own) == facts.contact_radius
        assert own[-1]["pressure_centre_mpa"] == facts.pressure


def test_closed_forms_meet_where_both_hold():
    sphere = 100.0
    for chi, share in ((0.1, -0.002), (0.25, -0.018)):  # the formula's own error, as the reference states it
        depth = (4.0 * chi) ** 2 / sphere
        of_half_space = 0.75 / (1.0 - 0.499**2)  # the formula is for nu = 0.5
        exact = LINEAR[chi][0] * hertz_force(sphere, depth) / of_half_space
        assert dimitriadis_force(sphere, depth) / exact - 1.0 == pytest.approx(share, abs=1.5e-3)


def test_profiles_are_read_by_depth_and_missing_ones_are_none_at_all(tmp_path):
    assert read_profiles(None, 3.5, 0.0) == {}
    assert read_profiles(tmp_path, 3.5, 0.0) == {}
    (tmp_path / "axisymmetric").mkdir()
    (tmp_path / "axisymmetric" / "profile.csv").write_text(
        "sphere_radius_mm,friction,depth_mm,r_mm,u_r_mm,u_z_mm\n3.5,0.0,0.5,0,0.0,-0.5\n3.5,0.0,0.5,1,0.02,-0.3\n"
        "3.5,0.78,0.5,1,0.01,-0.3\n7.0,0.0,0.5,1,0.02,-0.4\n"
    )
    profiles = read_profiles(tmp_path, 3.5, 0.0)
    assert list(profiles) == [0.5]
    np.testing.assert_array_equal(profiles[0.5], [[0.0, 0.0, 0.5], [1.0, 0.02, 0.3]])


def indented(sphere, depth, radii) -> LayerPress:
    """A surface that lies on the sphere as far as 1 mm and is flat beyond."""
    u = np.zeros((1, len(AZIMUTHS), len(radii), 3))
    u[..., 1] = depth - sphere + np.sqrt(sphere**2 - np.minimum(radii, 1.0) ** 2)
    return LayerPress(0, sphere, np.array([depth]), radii, np.ones(1), u, np.zeros(0), [], SimpleNamespace())


def test_contact_radius_is_where_the_surface_leaves_the_sphere():
    radii = np.arange(0.0, 3.0, 0.02)
    assert contact_radius(indented(3.5, 0.4, radii), 0.4) == pytest.approx(1.0, abs=0.02)


def test_surface_error_weighs_by_area_within_the_deformation_region():
    radii = np.array([0.0, 1.0, 2.0, 3.0])
    pressed = indented(3.5, 0.4, radii)
    profile = np.column_stack([radii, np.zeros(4), pressed.displacement[0, 0, :, 1]])
    assert surface_error(pressed, 0.4, profile) == 0.0
    profile[:, 2] += 0.02  # now all radii have moved
    assert surface_error(pressed, 0.4, profile) == pytest.approx(0.02, rel=1e-12)
    profile[:, 2] = [0.3, 0.0, 0.0, 0.0]
    profile[2:, 2] = 0.004  # below what counts as moved
    moved = pressed.displacement[0, 0, :, 1]
    assert surface_error(pressed, 0.4, profile) == pytest.approx(abs(0.3 - moved[0]), rel=1e-12)
    turned = pressed.displacement.copy()
    turned[..., 2] = 0.05
    profile[:, 2] = moved
    assert surface_error(replace(pressed, displacement=turned), 0.4, profile) == pytest.approx(0.05, rel=1e-12)


def test_pressure_swing_sees_what_alternates_and_not_what_is_straight():
    rest = indented(3.5, 0.4, np.arange(3.0))
    rings = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 5.0])
    straight = replace(rest, rings=rings, pressure=[np.full(3, 1.0 - 0.1 * r) for r in rings])
    assert pressure_swing(straight) == pytest.approx(0.0, abs=1e-15)
    around = [values + np.array([0.05, 0.0, -0.05]) for values in straight.pressure]
    assert pressure_swing(replace(straight, pressure=around)) == pytest.approx(0.05 * math.sqrt(2.0 / 3.0))
    across = [values + 0.05 * (-1) ** i for i, values in enumerate(straight.pressure)]
    assert pressure_swing(replace(straight, pressure=across)) == pytest.approx(0.1 / 1.05)


def test_planes_of_symmetry_stand_for_the_other_quarters():
    """A quarter and a half of one layer: the same force on the whole."""
    depths = np.array([0.2, 0.4])
    quarter = press_layer(COARSE, 3.5, 0.3, depths, np.array([0.0, 2.0]), "cpu")
    mesh = round_layer(graded(10.0, 0.8, 1.0, 0.5), graded(4.0, 0.8, 0.8, 0.25), layer_press.SEGMENTS, 2)
    fixed = np.zeros(mesh.nodes.shape, dtype=bool)
    fixed[on_plane(mesh.nodes, 2, 0.0), 2] = True
    fixed[on_plane(mesh.nodes, 1, 4.0)] = True
    half = make_sensor(mesh, fixed, top(mesh.nodes, mesh.faces), np.zeros((1, 3)))
    scene = layer_press.Scene(half, layer_press.Material(youngs_modulus_pa=539e3, poisson_ratio=0.499, friction=0.3,
                                                         source="the test's"))  # fmt: skip
    shape = layer_press.rigid_shape(layer_press.Kind.SPHERE, 3.5)
    result = layer_press.press(scene, [shape], np.eye(4)[None], depths * 1e-3)[0]
    np.testing.assert_allclose(2.0 * result.force[:, 1], quarter.force, rtol=5e-3)  # the solver's contact tolerance
    assert abs(result.force[-1, 0]) < 5e-3 * result.force[-1, 1]
    centre = quarter.displacement[-1, :, 0]
    np.testing.assert_allclose(centre[:, [0, 2]], 0.0, atol=1e-12)  # the axis lies in both planes
    assert centre[0, 1] == pytest.approx(0.4, abs=0.02)


def test_a_press_that_fails_says_where_and_why(monkeypatch):
    failed = SimpleNamespace(status=np.array([0, 1]))
    monkeypatch.setattr(layer_press, "press", lambda *_: [failed])
    with pytest.raises(RuntimeError, match=r"0\.2 mm was not reached: Newton"):
        press_layer(COARSE, 3.5, 0.0, np.array([0.1, 0.2]), np.zeros(1), "cpu")


def test_rows_of_surfaces_need_a_profile():
    depths = increments(1.0)
    assert set(DEPTHS_MM[:4]) <= set(depths) and np.diff(depths).max() <= 0.1 + 1e-9
    pressed = replace(indented(3.5, 0.5, np.array([0.0, 1.0])), depths=np.array([0.5]))
    rows = reference_rows(pressed, 0.0, 0.2, {}, [0.5])
    assert [row.quantity.split(" at ")[0] for row in rows] == ["force", "contact radius"]
    profile = np.array([[0.0, 0.0, 0.5], [1.0, 0.0, 0.4]])
    assert len(reference_rows(pressed, 0.0, 0.2, {0.5: profile}, [0.5])) == 3


def test_every_pair_of_the_reference_is_a_case():
    names = {f"layer-{sphere:g}mm" + (f"-friction-{friction:g}" if friction else "") for sphere, friction in REFERENCES}
    assert names | {"layer-quick", "layer-linear"} == {name for name in all_cases() if name.startswith("layer-")}
    for name in names:  # they run in processes of their own
        assert pickle.loads(pickle.dumps(all_cases()[name])).name == name


@pytest.mark.slow
def test_small_indentation_meets_linear_theory(tmp_path):
    outcome = solve_linear(Context("cpu", None, None, tmp_path))
    assert [row for row in outcome.rows if not row.passed] == []


def test_quarter_layer_holds_its_bottom_and_its_planes():
    sensor = quarter_layer(COARSE, np.zeros(1))
    nodes, fixed = sensor.simulation_mesh.nodes * 1e3, sensor.simulation_mesh.held
    assert fixed[np.isclose(nodes[:, 1], 4.0)].all()
    above = nodes[:, 1] < 3.9
    np.testing.assert_array_equal(fixed[above], np.stack([nodes[above, 0] == 0.0, np.zeros(above.sum(), dtype=bool),
                                                         nodes[above, 2] == 0.0], axis=1))  # fmt: skip
