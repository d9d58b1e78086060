"""Twist and shear of a contact against closed forms."""

import numpy as np

from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from simgen.sensors.sensor import Material
from simgen.simulation.press import Scene, follow
from simgen.units import MM_PER_M
from simgen.verification.validate.friction import Ball, press_then_shear, slide
from simgen.verification.validate.layer_meshes import graded, make_sensor, round_layer
from simgen.verification.validate.meshes import on_plane, top

SHEAR_MODULUS_MPA = 0.2


def cylinder(radius, height, edge, friction, poisson_ratio):
    """A scene with a cylinder, its top at y = 0 and its bottom bonded."""
    mesh = round_layer(graded(radius, edge, radius, 0.0), graded(height, edge, height, 0.0), segments=4, quarters=4)
    fixed = on_plane(mesh.nodes, 1, height)
    sensor = make_sensor(mesh, fixed, top(mesh.nodes, mesh.faces), np.zeros((1, 3)))
    modulus = 2e6 * SHEAR_MODULUS_MPA * (1.0 + poisson_ratio)
    return Scene(sensor, Material(youngs_modulus_pa=modulus, poisson_ratio=poisson_ratio, friction=friction))


def test_a_twisted_cylinder_carries_the_torque_of_torsion():
    """A flat face that sticks to the whole end of a cylinder twists it: M = G (pi a^4 / 2) angle / height.

    The formula is exact for a neo-Hookean cylinder of any twist (Rivlin, Phil. Trans. R. Soc. A 241, 1948). The press
    before it is 0.5 % of the height. The tolerance covers its effect.
    """
    radius, height, angle = 2.0, 4.0, np.radians(1.0)
    scene = cylinder(radius, height, edge=1.0, friction=2.0, poisson_ratio=0.3)
    path_mm = np.array([[0.0, 0.02, 0.0]] * 3)
    plate, turns = rigid_shape(Kind.CUBE, 7.0, 1.0), [0.0, angle / 2, angle]
    result = follow(scene, [plate], np.eye(4)[None], path_mm / MM_PER_M, turns)[0]
    assert (result.status == 0).all()
    torque = MM_PER_M * result.moment[:, 1]  # N mm about the axis
    expected = SHEAR_MODULUS_MPA * np.pi * radius**4 / 2.0 * np.array([0.5, 1.0]) * angle / height
    np.testing.assert_allclose(torque[1:], expected, rtol=0.01)
    assert abs(torque[0]) < 1e-3 * expected[1]
    assert np.abs(result.shear_force).max() < 1e-3 * result.force[0, 1]


def test_a_sheared_sphere_sticks_in_the_middle_and_slides_around_it():
    """Under a tangential force Q a sphere pressed by N sticks within c = a (1 - Q / (mu N))^(1/3).

    Cattaneo (1938) and Mindlin (J. Appl. Mech. 16, 1949; Johnson, Contact Mechanics, eq. 7.41), for an incompressible
    half-space, where normal and tangential tractions do not couple. The contact's edge and c lie within elements, whose
    points count whole: the tolerance is a quarter of an edge.
    """
    ball, friction = Ball(edge=0.16), 0.3
    path = press_then_shear([0.5 * ball.depth, ball.depth], np.array([0.01, 0.02, 0.03, 0.3]))
    _, result = slide(ball.layer(np.zeros((1, 3))), ball.shape(), friction, path, "cpu")
    loaded = result.shear_force[:, 0] / (friction * result.force[:, 1])
    stick_radius = ball.contact_radius * np.sqrt(1.0 - result.slip_share)
    expected = ball.contact_radius * (1.0 - loaded[2:5]) ** (1.0 / 3.0)
    print("Q / mu N", loaded.round(3), "sticks within", stick_radius.round(3), "mm, expected", expected.round(3))
    np.testing.assert_allclose(stick_radius[2:5], expected, atol=ball.edge / 4.0)
    assert result.slip_share[5] > 0.99
