"""The share of the gel that indenters leave: closed forms on slabs, wedges and skins; distances on the sensors."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from simgen.config.indenter_path import press_path, with_legs
from simgen.geometry.curved_tetrahedra import CORE, FREE, HELD
from simgen.geometry.rigid_shape import sampled_shape, signed_distance
from simgen.sensors.indenter import load_indenter
from simgen.sensors.indenter_pose import advanced
from simgen.sensors.least_thickness import LeastThickness
from simgen.sensors.pairing import indenter_poses, sample_contacts
from simgen.sensors.sensor import load_sensor
from simgen.sensors.sensor_schema import SupportPlane
from simgen.sensors.support import Support, plate_under
from simgen.simulation.first_touch import first_touch

THICK, SLOPE, LAST = 4.0, 0.15, 2.0  # mm, of wedges; the last depth, mm
PRESS = press_path(1e-3 * np.linspace(0.1, LAST, 20))
CUBE, SPHERE, LONG = (load_indenter(name).shape() for name in ("cube_14mm", "sphere_7mm", "cylinder_long_7mm"))


def wedge(slope: float = 0.0) -> SimpleNamespace:
    """A gel of 40 x 40 mm under the plane y = 0, THICK - slope x deep, its back held."""
    surface = trimesh.creation.box(extents=[40e-3, 1.0, 40e-3])
    back = surface.vertices[:, 1] > 0.0
    surface.vertices[:, 1] = np.where(back, 1e-3 * THICK - slope * surface.vertices[:, 0], 0.0)
    held = (surface.triangles[:, :, 1] > 0.0).all(axis=1)
    return SimpleNamespace(surface=surface, surface_region=np.where(held, HELD, FREE), core=None, support=None)


def skin_over_core(skin: float, gap: float) -> SimpleNamespace:
    """A flat skin over a gap and a core; mm. Its outside is y = 0."""
    outer = trimesh.creation.box(extents=[0.040, 0.020, 0.040])
    cavity = trimesh.creation.box(extents=[0.036, 0.020 - 2e-3 * skin, 0.036])
    cavity.invert()
    core = trimesh.creation.box(extents=[0.034, 0.020 - 2e-3 * (skin + gap), 0.034])
    surface = trimesh.util.concatenate([outer, cavity]).apply_translation([0.0, 0.010, 0.0])
    core.apply_translation([0.0, 0.010, 0.0])
    return SimpleNamespace(surface=surface, surface_region=np.repeat([FREE, CORE], 12), core=core, support=None)


def on_plate(beyond: float) -> SimpleNamespace:
    """A wedge without slope on a plate in the plane y = THICK."""
    sensor = wedge()
    plane = SupportPlane(axis="y", at_mm=THICK, beyond_outline_mm=beyond)
    sensor.support = Support(plate_under(sensor.surface, plane, Path("sensor.yaml")), None, "")
    return sensor


def pose(x: float = 0.0, tilt_deg: float = 0.0) -> np.ndarray:
    """(1, 4, 4): the tip on the surface at x mm, tilted about z."""
    made = trimesh.transformations.rotation_matrix(np.radians(tilt_deg), [0.0, 0.0, 1.0])
    made[0, 3] = 1e-3 * x
    return made[None]


def share(sensor, shape, path=PRESS, **where) -> float:
    return LeastThickness(sensor, [shape], path).shares(pose(**where)).item()


@pytest.mark.parametrize("shape", [CUBE, SPHERE, LONG])
@pytest.mark.parametrize("tilt", [0.0, 7.0])
def test_a_slab_keeps_what_the_lowest_point_does_not_take(shape, tilt):
    """The lowest point goes down by the depth times the cosine of the tilt."""
    expected = 1.0 - LAST * np.cos(np.radians(tilt)) / THICK
    assert share(wedge(), shape, tilt_deg=tilt) == pytest.approx(expected, abs=1e-6)


def test_the_least_place_counts_not_the_contact_point():
    """Under a flat cube on a wedge it lies on the fillet at the thin side: half width 7 mm, fillet 1 mm."""
    x = np.linspace(-7.0, 7.0, 100_001)
    lift = 1.0 - np.sqrt(1.0 - np.maximum(np.abs(x) - 6.0, 0.0) ** 2)
    thickness = THICK - SLOPE * x
    expected = ((thickness - LAST + lift) / thickness).min()
    assert expected < 0.36 < 1.0 - LAST / THICK
    assert share(wedge(SLOPE), CUBE) == pytest.approx(expected, abs=0.003)  # columns are 0.25 mm wide


def test_a_tilted_cube_counts_at_its_low_edge():
    """On a wedge the same tilt to either side leaves different shares; the low edge decides."""

    def expected(tilt):
        """With columns along the axis, by the outline of the cube's section at fine steps."""
        angle = np.radians(np.linspace(0.0, 90.0, 2001))
        corner = np.column_stack([6.0 + np.sin(angle), np.cos(angle) - 1.0])
        face = np.column_stack([np.linspace(-6.0, 6.0, 2001), np.zeros(2001)])
        x, y = np.concatenate([corner * [-1.0, 1.0], face, corner]).T
        cos, sin = np.cos(np.radians(tilt)), np.sin(np.radians(tilt))
        px, py = cos * x - sin * y, sin * x + cos * y
        moved_x, moved_y = px - sin * (LAST - py.max() / cos), py + cos * (LAST - py.max() / cos)
        # From a point (x, y) along the axis (-sin, cos) to the back y = THICK - SLOPE x, and back to y = 0.
        left = (THICK - SLOPE * moved_x - moved_y) / (cos - SLOPE * sin)
        return (left / (left + moved_y / cos)).min()

    found = {tilt: share(wedge(SLOPE), CUBE, tilt_deg=tilt) for tilt in (-5.0, 5.0)}
    for tilt, value in found.items():
        assert value == pytest.approx(expected(tilt), abs=0.004)
    assert found[5.0] < found[-5.0] - 0.05  # +5 degrees lower the side of +x, where the gel is thin


def test_a_skin_has_the_gap_on_top():
    for depth in (0.5, 1.0, 2.0):
        path = press_path([1e-3 * depth])
        assert share(skin_over_core(1.5, 1.0), CUBE, path) == pytest.approx((2.5 - depth) / 1.5, abs=1e-6)


def test_a_mesh_of_a_user_counts_wherever_its_tip_is():
    """A box of 6 mm, its face 5 mm above the tip plane or below: first touch comes as much earlier or later."""
    for height in (-5.0, 5.0):
        box = trimesh.creation.box([6e-3, 6e-3, 6e-3]).apply_translation([0.0, 1e-3 * height - 3e-3, 0.0])
        assert share(wedge(), sampled_shape(box, 0.2, 3.0)) == pytest.approx(1.0 - LAST / THICK, abs=1e-3)


def test_places_beyond_the_outline_do_not_count():
    assert share(wedge(), CUBE, x=18.0) == pytest.approx(1.0 - LAST / THICK, abs=1e-6)
    assert share(wedge(), CUBE, x=30.0) == np.inf


def test_beyond_the_outline_an_indenter_stays_out_of_the_support():
    """A cube across the outline of an upright gel: no column meets the plate before one meets the back."""
    steep = {"x": 18.0, "tilt_deg": 30.0}  # the tilt lowers the side beyond the outline
    bare, measure = LeastThickness(wedge(), [CUBE], PRESS), LeastThickness(on_plate(10.0), [CUBE], PRESS)
    flat = pose(18.0)
    assert measure.shares(flat) == bare.shares(flat)
    np.testing.assert_allclose(measure.depths_that_leave(flat, 0.0), 1e-3 * THICK, atol=1e-6)
    tilted = pose(**steep)
    assert bare.shares(tilted) > 0.4 and measure.shares(tilted) == -np.inf
    narrow = LeastThickness(on_plate(0.5), [CUBE], PRESS)  # a plate that ends before the cube's low edge
    assert narrow.shares(tilted) == bare.shares(tilted)


def test_the_depth_at_which_an_indenter_meets_the_support():
    """By signed distances at points of the plate's face; indenters that reach over the DIGIT's outline."""
    sensor, shapes = load_sensor("digit"), [CUBE, LONG]
    poses = indenter_poses(sample_contacts(sensor, 40, 1, LAST * 1e-3))
    depths = LeastThickness(sensor, shapes, PRESS).depths_that_leave(poses, 0.0)[:, :, 0]
    without = replace(sensor, support=None)
    earlier = depths < LeastThickness(without, shapes, PRESS).depths_that_leave(poses, 0.0)[:, :, 0] - 1e-5
    assert earlier.sum() >= 5
    low, high = sensor.support.body.bounds_mm
    x, z = np.meshgrid(np.arange(low[0], high[0], 0.1), np.arange(low[2], high[2], 0.1), indexing="ij")
    face = np.column_stack([x.ravel(), np.full(x.size, sensor.support.body.at_mm), z.ravel()])
    face = face[np.abs(sensor.support.distance(1e-3 * face)) < 1e-6]
    mesh, in_mm = sensor.simulation_mesh, poses.copy()
    in_mm[:, :3, 3] *= 1e3
    for i, shape in enumerate(shapes):
        travel, _, _ = first_touch(mesh.nodes * 1e3, mesh.touchable, [shape] * len(poses), in_mm)
        for end in advanced(poses, 1e-3 * travel + depths[:, i])[earlier[:, i]]:
            gap = signed_distance(shape, (face - 1e3 * end[:3, 3]) @ end[:3, :3])[0].min()
            assert abs(gap) < 0.03  # mm


def test_an_indenter_in_the_back_leaves_less_than_nothing():
    assert share(wedge(), CUBE, press_path([5e-3])) == pytest.approx(-0.25, abs=1e-6)


def test_a_path_counts_where_it_goes():
    """A sphere that moves 6 mm to the thin side of a wedge, and lets go there before it moves on."""
    legs = [((6e-3, 0.0, 0.0), 0.0, 2), ((0.0, -3e-3, 0.0), 0.0, 1), ((6e-3, 0.0, 0.0), 0.0, 1)]
    x = np.linspace(2.6, 9.4, 100_001)
    lift = 3.5 - np.sqrt(3.5**2 - (x - 6.0) ** 2)
    thickness = THICK - SLOPE * x
    expected = ((thickness - LAST + lift) / thickness).min()
    assert share(wedge(SLOPE), SPHERE, with_legs(PRESS, legs)) == pytest.approx(expected, abs=0.003)


def test_a_turn_counts():
    """A long cylinder across a wedge, turned along it: its end reaches 13 mm to the thin side."""
    across = trimesh.transformations.rotation_matrix(np.pi / 2, [0.0, 1.0, 0.0])[None]
    straight, turned = (
        LeastThickness(wedge(0.1), [LONG], path).shares(across).item()
        for path in (PRESS, with_legs(PRESS, [((0.0, 0.0, 0.0), np.pi / 2, 1)]))
    )
    along = share(wedge(0.1), LONG)
    assert straight > along + 0.1
    assert turned == pytest.approx(along, abs=0.003)


def test_depths_and_steps_that_leave_a_share():
    measure = LeastThickness(wedge(), [CUBE, SPHERE], with_legs(PRESS, [((1e-3, 0.0, 0.0), 0.0, 2)]))
    depths = measure.depths_that_leave(pose(), 0.65)
    assert depths.shape == (1, 2, 22)
    np.testing.assert_allclose(depths, 0.35e-3 * THICK, atol=1e-9)
    np.testing.assert_array_equal(measure.steps_that_leave(pose(), 0.645), [[14, 14]])  # 1.4 of 1.42 mm
    np.testing.assert_array_equal(measure.steps_that_leave(pose(), 0.4), [[22, 22]])
    np.testing.assert_array_equal(measure.steps_that_leave(pose(), 0.999), [[0, 0]])


def test_results_do_not_depend_on_how_many_are_measured_together(monkeypatch):
    poses = np.concatenate([pose(x, tilt) for x, tilt in ((0.0, 0.0), (15.0, 3.0), (-4.0, -6.0))])
    measure = LeastThickness(wedge(0.1), [CUBE, LONG], PRESS)
    together = measure.shares(poses)
    monkeypatch.setattr("simgen.sensors.least_thickness.MOST_COLUMNS", 1)
    np.testing.assert_array_equal(measure.shares(poses), together)
    assert measure.shares(poses[:0]).shape == (0, 2)


@pytest.mark.parametrize("name", ["digit", "biotac", "gelsight_mini"])
def test_at_the_depth_that_leaves_nothing_the_indenter_meets_the_rigid_body(name):
    """By first touch on the mesh that is pressed, and by signed distances at points of back or core."""
    sensor, shapes = replace(load_sensor(name), support=None), [CUBE, SPHERE, LONG]
    poses = indenter_poses(sample_contacts(sensor, 3, 1, LAST * 1e-3))
    depths = LeastThickness(sensor, shapes, PRESS).depths_that_leave(poses, 0.0)[:, :, 0]
    back = sensor.surface.submesh([sensor.surface_region == HELD], append=True)
    body = back if sensor.core is None else sensor.core.subdivide_to_size(0.15e-3, max_iter=20)
    rigid = body.vertices
    mesh = sensor.simulation_mesh
    in_mm = poses.copy()
    in_mm[:, :3, 3] *= 1e3
    for i, shape in enumerate(shapes):
        travel, _, _ = first_touch(mesh.nodes * 1e3, mesh.touchable, [shape] * 3, in_mm)
        for end in advanced(poses, 1e-3 * travel + depths[:, i]):
            gap = signed_distance(shape, 1e3 * (rigid - end[:3, 3]) @ end[:3, :3])[0].min()
            assert abs(gap) < 0.03  # mm
