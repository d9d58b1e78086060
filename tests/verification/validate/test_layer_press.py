"""A press on the layer: boundary conditions, and the measures of its result."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from simgen.verification.validate import layer_press
from simgen.verification.validate.layer_meshes import graded, make_sensor, round_layer
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
from simgen.verification.validate.meshes import on_plane, top

COARSE = LayerMeshSize(edge=0.8, until=1.0, growth=0.5, top=0.8)


def indented(sphere, depth, radii) -> LayerPress:
    """Make a surface that lies on the sphere up to a radius of 1 mm and is flat beyond."""
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
    profile[2:, 2] = 0.004  # below the limit of the deformation region
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


def test_quarter_layer_holds_its_bottom_and_its_planes():
    sensor = quarter_layer(COARSE, np.zeros(1))
    nodes, fixed = sensor.simulation_mesh.nodes * 1e3, sensor.simulation_mesh.held
    assert fixed[np.isclose(nodes[:, 1], 4.0)].all()
    above = nodes[:, 1] < 3.9
    np.testing.assert_array_equal(fixed[above], np.stack([nodes[above, 0] == 0.0, np.zeros(above.sum(), dtype=bool),
                                                         nodes[above, 2] == 0.0], axis=1))  # fmt: skip
