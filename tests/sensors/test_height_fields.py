"""Gels with a height field: the GelSight Mini's pad against the figures of its maker's CAD, and the DIGIT's outline."""

import numpy as np
import pytest

from simgen.geometry.curved_tetrahedra import HELD
from simgen.geometry.surface import shells
from simgen.sensors.height_fields import pad_outline, pad_thickness, shoulder
from simgen.sensors.sensor_geometry import load_geometry
from simgen.sensors.sensor_schema import Pad
from simgen.units import MM

# Vertices of the CAD: x and z from the middle, thickness there, mm.
FACE = [(6.0, 0.0, 3.905), (0.0, 4.5, 3.911), (6.0, 4.5, 3.839), (6.0, 7.535, 3.722), (9.716, 4.5, 3.724)]
SHOULDER = [(9.716, 8.875, 3.471), (11.125, 7.535, 3.462)]
CORNER = [(11.125, 8.875, 3.309)]
WALL = [(12.625, 0.0, 2.75), (12.625, 8.875, 2.75), (0.0, 10.375, 2.75), (11.125, 10.375, 2.75)]


@pytest.fixture(scope="module")
def geometry():
    return load_geometry("gelsight_mini")


@pytest.fixture(scope="module")
def pad(geometry):
    return geometry.description.gel.pad


def off(pad, vertices) -> float:
    """Largest difference, mm, of the thickness from that of vertices of the CAD, in all four quarters."""
    x, z, height = np.array(vertices).T
    quarters = [pad_thickness(pad, np.column_stack([pad.center_x_mm + i * x, k * z])) for i in (1, -1) for k in (1, -1)]
    return np.abs(np.array(quarters) - height).max()


def test_the_pad_has_the_heights_of_the_cad(pad):
    """Vertices that the sensor.yaml does not give: they follow from the form of the face and of the shoulder."""
    assert off(pad, FACE) < 0.001
    assert off(pad, SHOULDER) < 0.001
    assert off(pad, CORNER) < 0.005
    assert off(pad, WALL) < 1e-9


def test_the_pad_has_the_outline_and_thickness_of_the_cad(geometry):
    surface = geometry.true.surface
    np.testing.assert_allclose(np.ptp(surface.vertices, axis=0) / MM, [25.25, 4.0, 20.75], atol=1e-6)
    on_corner = np.hypot(12.625 - 1.5 * (1 - np.sqrt(0.5)), 10.375 - 1.5 * (1 - np.sqrt(0.5)))
    outline = pad_outline(geometry.description.gel.pad)[0] + [7.56, 0.0]
    assert np.abs(np.linalg.norm(outline, axis=1) - on_corner).min() < 1e-9
    held = geometry.true.part(HELD)(np.array([[-7.56, -4.3, 0.0], [-7.56, -8.3, 0.0]]) * MM)[1]
    np.testing.assert_allclose(held / MM, [0.0, 4.0], atol=1e-6)


def test_the_surface_is_closed_and_has_the_volume_of_its_heights(geometry, pad):
    surface = geometry.true.surface
    assert surface.is_watertight and len(shells(surface)) == 1
    x, z = np.meshgrid(np.arange(-12.6, 12.625, 0.05), np.arange(-10.35, 10.375, 0.05))  # middles of cells
    inside = np.hypot(np.maximum(np.abs(x) - 11.125, 0), np.maximum(np.abs(z) - 8.875, 0)) < 1.5
    heights = pad_thickness(pad, np.column_stack([pad.center_x_mm + x[inside], z[inside]]))
    assert surface.volume / MM**3 == pytest.approx(heights.sum() * 0.05**2, rel=2e-3)


def test_face_and_shoulder_meet_without_a_kink(pad):
    for x, z, step in ((9.716, 3.0, [1e-4, 0.0]), (5.0, 7.535, [0.0, 1e-4])):
        points = np.array([pad.center_x_mm + x, z]) + np.outer([-1.0, 0.0, 1.0], step)
        before, after = np.diff(pad_thickness(pad, points)) / 1e-4
        assert before < 0
        assert after == pytest.approx(before, abs=1e-4)


def test_a_shoulder_is_an_arc():
    """From flat, 1 mm over 1 mm is a quarter of a circle."""
    along = np.array([0.0, 0.6, 0.8, 1.0])
    found = shoulder(along, 1.0, np.ones(4), np.zeros(4))
    np.testing.assert_allclose(found, [1.0, 0.8, 0.6, 0.0], atol=1e-7)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"wall_mm": 3.7}, "the face must be above wall_mm everywhere"),
        ({"half_length_mm": 10.0}, "further from the walls than above it"),
        ({"corner_radius_mm": 11.0}, "corner_radius_mm must be at most half_length_mm"),
    ],
)
def test_a_pad_that_is_none(pad, change, says):
    with pytest.raises(ValueError, match=says):
        Pad.model_validate({**pad.model_dump(), **change})
