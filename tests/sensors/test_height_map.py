"""Depths and heights against closed forms and against rays traced one by one."""

import numpy as np
import pytest

from simgen.sensors.height_map import HeightMaps
from tests.sensing.camera import scenes
from tests.sensing.camera.scenes import DISTANCE_M, in_sensor, pinhole, sheet

UM = 1e-6  # m: what the issue of height maps allows
SINGLE = 5e-9  # m: rounding of 20 mm in single precision is 1e-9, and a few operations

pytestmark = pytest.mark.filterwarnings("error")


def across(of):
    """Right and up of each pixel at a depth of 1, (height, width) each."""
    rows, columns = np.mgrid[: of.height, : of.width]
    return of.across(rows, columns)


def test_a_plane_across_the_axis_has_one_depth():
    of = pinhole()
    maps = HeightMaps(*sheet(lambda x, y: DISTANCE_M, of, cells=1), of)
    assert maps.seen.all()
    np.testing.assert_allclose(maps.rest_depth, DISTANCE_M, atol=SINGLE)


def test_a_tilted_plane_is_met_where_it_is():
    of = pinhole()
    maps = HeightMaps(*sheet(lambda x, y: DISTANCE_M + 0.3 * x - 0.2 * y, of, cells=3), of)
    x, y = across(of)
    np.testing.assert_allclose(maps.rest_depth, DISTANCE_M / (1.0 - 0.3 * x + 0.2 * y), atol=SINGLE)


def test_a_sphere_that_is_pressed_into_a_plane():
    """Diagonals of 0.11 mm, on the slope 0.15 mm, lie 0.7 um off a radius of 4 mm. The rim, where they bridge a kink,
    is left out."""
    of, radius, deep = pinhole(320, 240), 4e-3, 1e-3
    vertices, triangles = sheet(lambda x, y: DISTANCE_M, of, cells=640)
    maps = HeightMaps(vertices, triangles, of)
    middle = DISTANCE_M + radius - deep

    view = of.in_view(vertices)
    beside = np.hypot(view[:, 0], view[:, 1])
    top = middle - np.sqrt(np.maximum(radius**2 - beside**2, 0.0))
    view[:, 2] = np.where(beside < radius, np.minimum(top, DISTANCE_M), DISTANCE_M)
    found = maps((in_sensor(view, of) - vertices)[None]).numpy()[0]

    x, y = across(of)
    square = x * x + y * y + 1.0
    below = middle**2 - square * (middle**2 - radius**2)
    depth = np.where(below > 0.0, (middle - np.sqrt(np.maximum(below, 0.0))) / square, np.inf)
    expected = DISTANCE_M - np.minimum(depth, DISTANCE_M)
    rim = np.sqrt(radius**2 - (radius - deep) ** 2)
    away = np.abs(np.hypot(x, y) * DISTANCE_M - rim) > 3e-4
    assert np.abs(found - expected)[away].max() < UM
    assert found.max() == pytest.approx(deep, abs=UM)


def test_every_pixel_is_what_a_ray_says_that_is_traced_alone():
    """A crumpled sheet that hides parts of itself, against Moeller and Trumbore's intersection with all triangles, in
    double precision.
    """
    of, random = pinhole(24, 18), np.random.default_rng(0)
    vertices, triangles = sheet(lambda x, y: DISTANCE_M, of, cells=12)
    crumpled = vertices + random.normal(0.0, 2e-3, vertices.shape)
    maps = HeightMaps(crumpled, triangles, of)
    x, y = across(of)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1)
    traced = np.array([[traced_depth(ray, of.in_view(crumpled)[triangles]) for ray in line] for line in rays])
    assert (np.isfinite(traced) == maps.seen).all()
    np.testing.assert_allclose(maps.rest_depth[maps.seen], traced[maps.seen], atol=1e-7)  # grazing triangles


def traced_depth(ray: np.ndarray, corners: np.ndarray) -> float:
    a, ab, ac = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(ray, ac)
    det = np.einsum("ti,ti->t", ab, p)
    u = np.einsum("ti,ti->t", -a, p) / det
    q = np.cross(-a, ab)
    v = q @ ray / det
    depth = np.einsum("ti,ti->t", ac, q) / det
    return np.where((u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (depth > 0.0), depth, np.inf).min()


def test_what_moves_towards_the_camera_rises():
    of = pinhole()
    vertices, triangles = sheet(lambda x, y: DISTANCE_M, of, cells=1)
    maps = HeightMaps(vertices, triangles, of)
    nearer, aside = -2e-4 * of.axes[2], 1e-3 * of.axes[0]
    moved = np.stack([np.tile(shift, (len(vertices), 1)) for shift in (nearer, aside, nearer - nearer)])
    found = maps(moved).numpy()
    np.testing.assert_allclose(found[0], 2e-4, atol=SINGLE)
    np.testing.assert_allclose(found[1:], 0.0, atol=SINGLE)


def test_samples_do_not_know_of_each_other():
    of, random = pinhole(), np.random.default_rng(1)
    vertices, triangles = sheet(lambda x, y: DISTANCE_M, of, cells=8)
    maps = HeightMaps(vertices, triangles, of)
    moved = random.normal(0.0, 3e-4, (3, *vertices.shape))
    together = maps(moved).numpy()
    for one, alone in zip(together, (maps(each[None]).numpy()[0] for each in moved), strict=True):
        np.testing.assert_array_equal(one, alone)


def test_beside_the_surface_heights_go_on():
    of = pinhole()
    vertices, triangles = sheet(lambda x, y: DISTANCE_M, of, size_m=0.01, cells=4)
    maps = HeightMaps(vertices, triangles, of)
    assert 0 < maps.seen.sum() < maps.seen.size and np.isinf(maps.rest_depth[~maps.seen]).all()
    found = maps(np.tile(-1e-4 * of.axes[2], (1, len(vertices), 1))).numpy()
    np.testing.assert_allclose(found, 1e-4, atol=SINGLE)


def test_holes_take_the_height_of_the_nearest_pixel():
    of = pinhole()
    vertices, triangles = sheet(lambda x, y: DISTANCE_M, of, cells=40)
    maps = HeightMaps(vertices, triangles, of)
    view = of.in_view(vertices)
    aside = np.where(view[:, :1] > 0.0, 2e-3, -2e-3) * of.axes[0] - 1e-4 * of.axes[2]  # it is torn in the middle
    torn = [triangle for triangle in triangles if len(np.unique(view[triangle, 0] > 0.0)) == 1]
    found = HeightMaps(vertices, np.array(torn), of)(aside[None]).numpy()[0]
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found, 1e-4, atol=SINGLE)
    assert maps(np.full((1, *vertices.shape), 1.0)).numpy().max() == 0.0  # all of it out of sight


def test_nothing_behind_the_camera_is_seen():
    of = pinhole()
    vertices, triangles = sheet(lambda x, y: DISTANCE_M, of, cells=1)
    behind, _ = sheet(lambda x, y: -DISTANCE_M, of, cells=1)
    maps = HeightMaps(np.vstack([vertices, behind]), np.vstack([triangles, triangles + len(vertices)]), of)
    np.testing.assert_allclose(maps.rest_depth, DISTANCE_M, atol=SINGLE)


def test_pixels_go_right_and_down():
    of = pinhole()
    assert scenes.camera().up @ of.axes[1] == pytest.approx(1.0)
    corner = in_sensor(np.array([[0.0, 0.0, 1.0], [0.1, 0.2, 1.0]]) * DISTANCE_M, of)
    triangle = np.vstack([corner, corner[:1] + 1e-3 * of.axes[0]])
    seen = HeightMaps(triangle, np.array([[0, 1, 2]]), of).seen
    rows, columns = np.nonzero(seen)
    assert len(rows) and rows.max() < 32 and columns.min() >= 24  # above and right of the middle
