"""A rig on the GelSight Mini's coarse mesh: its place, its forces and their scale, and what it refuses."""

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from simgen.calibration.rig import Rig
from simgen.errors import InputError
from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from simgen.sensors.sensor import load_sensor
from simgen.simulation.press import Scene, press
from simgen.units import MM

RADIUS_MM, THICKNESS_MM = 7.5, 4.0
DEPTH = np.arange(1, 7) * 0.1


@cache
def gel(mesh="coarse"):
    return load_sensor("gelsight_mini", mesh)


def make(place_mm=None, mesh="coarse"):
    return Rig(gel(mesh), rigid_shape(Kind.SPHERE, RADIUS_MM), gel(mesh).materials["solid"], place_mm)


def test_the_middle_of_the_pad_is_pressed_straight():
    pose = make().pose
    np.testing.assert_allclose(pose[:3, 3], [-7.56e-3, -8.3e-3, 0.0], atol=1e-6)
    np.testing.assert_allclose(pose[:3, 1], [0.0, 1.0, 0.0], atol=1e-3)
    aside = make((-4.0, 3.0)).pose
    assert aside[0, 3] == pytest.approx(-4e-3) and aside[2, 3] == pytest.approx(3e-3, abs=1e-5)


def test_forces_are_proportional_to_e():
    """A press with another E, and the same with E of the fit's presses times the ratio."""
    rig = make()
    curve = rig.press(rig.values(c20=0.02), DEPTH)
    solid = rig.solid(3.3e5, rig.values(c20=0.02))
    assert solid.law == "yeoh" and solid.c20_pa == pytest.approx(6600.0)
    result = press(Scene(gel(), solid), [rig.shape], rig.pose[None], DEPTH * MM)[0]
    np.testing.assert_allclose(result.force @ rig.pose[:3, 1], 3.3e5 * curve.force, rtol=1e-9)
    assert rig.press(rig.values(c20=0.02), DEPTH) is curve  # not pressed again


def test_the_force_is_that_along_the_press(monkeypatch):
    """A load cell in the axis of the press does not feel the force across it."""
    rig = make((-4.0, 3.0))
    along, across = rig.pose[:3, 1], rig.pose[:3, 0]
    result = SimpleNamespace(status=np.zeros(2, np.int8), force=np.array([3.0 * along + 4.0 * across, 6.0 * along]),
                             force_error_estimate=np.zeros(2))  # fmt: skip
    monkeypatch.setattr("simgen.calibration.rig.press", lambda *_, **__: [result])
    monkeypatch.setattr("simgen.calibration.rig.Scene", lambda *_, **__: None)
    monkeypatch.setattr("simgen.calibration.rig.has_values", lambda status: np.ones(2, bool))
    np.testing.assert_allclose(1e6 * rig.press(rig.values(), np.array([0.1, 0.2])).force, [3.0, 6.0])


@pytest.mark.slow
def test_small_depths_agree_with_the_theory_of_a_bonded_layer():
    """Dimitriadis et al., Biophys. J. 82, 2002, eq. 8, for nu = 0.5; the pad's front is a little domed."""
    rig, depth = make(mesh="default"), np.array([0.1, 0.2, 0.3])
    curve = rig.press(rig.values(nu=0.4999, friction=0.0), depth)
    chi = np.sqrt(RADIUS_MM * depth) / THICKNESS_MM
    layer = 1.0 + 1.133 * chi + 1.283 * chi**2 + 0.769 * chi**3 + 0.0975 * chi**4
    theory = 16.0 / 9.0 * np.sqrt(RADIUS_MM * MM) * (depth * MM) ** 1.5 * layer
    np.testing.assert_allclose(curve.force, theory, rtol=0.05)
    assert (curve.mesh_error < 0.01).all()


def test_it_refuses_places_depths_and_materials():
    with pytest.raises(InputError, match=r"nothing to touch at x = 40 mm, arc 0 mm; allowed: x within"):
        _ = make((40.0, 0.0)).pose
    with pytest.raises(InputError, match=r"a depth of 3.9 mm leaves 0\.0\d* of the gel .*; allowed: at most 3\.\d+ mm"):
        make().check_room(3.9)
    with pytest.raises(InputError, match=r"a depth of 3.7 mm, with 10% more for the offset, leaves"):
        make().check_room(3.7, 0.1)
    make().check_room(2.2)
    with pytest.raises(InputError, match=r"material of gelsight_mini: youngs_modulus_pa: 1\.0 is not allowed"):
        make().solid(1.0, make().values())
