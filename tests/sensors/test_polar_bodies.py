"""The parametric sensors: closed, in place, and as near to the published meshes as the project asks."""

import numpy as np
import pytest

from simgen.geometry import mesh_files
from simgen.geometry.curved_tetrahedra import CORE
from simgen.geometry.surface import ClosestPoint, shells
from simgen.sensors.sensor_geometry import load_geometry
from simgen.units import MM
from simgen.verification.validate.published_geometry import gel_thickness, touchable_distances, wall_thickness
from simgen.verification.validate.published_sensors import published_surface

MEAN, MOST = 0.10, 0.40  # mm, over the touchable surface: the project's bounds


@pytest.fixture(scope="module", params=["digit", "biotac"])
def sensor(request):
    return load_geometry(request.param)


@pytest.fixture(scope="module")
def published(sensor, reference):
    return published_surface(reference, sensor.description.name)


def test_surfaces_are_closed(sensor):
    surface = sensor.true.surface
    assert surface.is_watertight
    assert surface.volume > 0
    assert len(shells(surface)) == (2 if sensor.description.name == "biotac" else 1)


def test_touchable_surface_is_near_the_published_one_both_ways(sensor, published):
    to_published, from_published = touchable_distances(sensor, published)
    for way, distance in (("to", to_published), ("from", from_published)):
        name = sensor.description.name
        print(f"{name} {way} published: mean {distance.mean():.4f} mm, max {distance.max():.4f} mm")
        assert distance.mean() <= MEAN
        assert distance.max() <= MOST


def test_volume_is_that_of_the_published_gel(sensor, published):
    # A mean distance of 0.02 mm over 600 mm2 (DIGIT) is 1 % of its volume.
    np.testing.assert_allclose(sensor.true.surface.volume, published.volume, rtol=0.01)


def test_wall_of_the_skin(reference):
    own_wall, wall = wall_thickness(load_geometry("biotac"), published_surface(reference, "biotac"))
    print(f"wall: ours {own_wall.mean():.3f} mm, published {wall.mean():.3f} mm")
    assert np.abs(own_wall - wall).mean() <= 0.10


def test_thickness_of_the_gel(reference):
    """Height above the back on a grid of (x, z), 1 mm and more inside the outline."""
    own, theirs = gel_thickness(load_geometry("digit"), published_surface(reference, "digit"))
    difference = np.abs(own - theirs)
    print(f"thickness: mean difference {difference.mean():.4f} mm, max {difference.max():.4f} mm")
    assert difference.mean() <= 0.10


def test_measured_dimensions():
    """Extents as measured on the published meshes (mm); the bounds are the project's mean distance."""
    skin = load_geometry("biotac").true.surface.vertices / MM
    np.testing.assert_allclose(skin.min(axis=0), [-21.31, -8.31, -7.11], atol=MEAN)
    np.testing.assert_allclose(skin.max(axis=0), [6.65, 5.33, 7.11], atol=MEAN)
    gel = load_geometry("digit").true.surface.vertices / MM
    np.testing.assert_allclose(gel.min(axis=0), [-20.06, -8.30, -9.20], atol=0.02)
    np.testing.assert_allclose(gel.max(axis=0), [4.94, -4.2365, 9.20], atol=0.02)


def test_the_core_lies_inside_the_cavity_with_its_clearance(reference):
    biotac = load_geometry("biotac")
    surface, core = biotac.true.surface, biotac.core
    cavity = surface.faces[biotac.true.region == CORE]
    on, gap, face = ClosestPoint(surface.vertices, cavity)(core.vertices)
    normals = surface.face_normals[biotac.true.region == CORE][face]
    assert np.einsum("ij,ij->i", core.vertices - on, normals).min() > 0  # gel normals point into the cavity
    assert gap.min() >= 0.02 * MM * (1 - 1e-6)
    assert core.is_watertight
    pad = core.vertices[core.vertices[:, 1].argmin()]
    assert ClosestPoint(surface.vertices, cavity)(pad[None])[1][0] == pytest.approx(1.35 * MM, abs=0.1 * MM)
    published = mesh_files.bodies(mesh_files.read_mesh(reference / "biotac/top_side_core_bc.obj", "m")[0])[0]
    distance = ClosestPoint(published.vertices, published.faces)(core.vertices)[1] / MM
    print(f"core: mean {distance.mean():.4f} mm, max {distance.max():.4f} mm")
    assert distance.mean() <= MEAN
    assert distance.max() <= MOST
