"""The grid of unrolled skins, on a cylinder whose places are known, and on a sensor of the fake dataset."""

import numpy as np
import pytest
import trimesh

from simgen.learning.networks.skin_grid import PixelGrid, SkinOnGrid, frames_of, reach_along_arc

RADIUS, LENGTH = 8e-3, 30e-3


@pytest.fixture(scope="module")
def cylinder() -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a cylinder along x, of 256 flat sides."""
    mesh = trimesh.creation.cylinder(RADIUS, LENGTH, sections=256)
    turned = mesh.vertices[:, [2, 0, 1]]
    return turned, np.asarray(mesh.faces)


@pytest.fixture(scope="module")
def on_grid(cylinder) -> SkinOnGrid:
    vertices, triangles = cylinder
    return SkinOnGrid(vertices, triangles, np.ones(len(vertices), bool), PixelGrid.over(-10e-3, 10e-3, 8e-3, 1e-3, 8))


def surface_point(x, arc, depth=0.0):
    angle = arc / RADIUS
    return np.stack([x, -(RADIUS - depth) * np.cos(angle), (RADIUS - depth) * np.sin(angle)], axis=-1)


def test_pixels_cover_the_box_and_are_symmetric():
    grid = PixelGrid.over(-10e-3, 11e-3, 8e-3, 1e-3, 8)
    assert grid.shape == (24, 16)
    np.testing.assert_allclose(grid.arc, -grid.arc[::-1])
    assert grid.x[0] <= -10e-3 + 0.5e-3 and grid.x[-1] >= 11e-3 - 0.5e-3
    np.testing.assert_allclose(np.diff(grid.x), 1e-3)
    assert PixelGrid.over(0.0, 1e-3, 1e-3, 1e-2, 1).shape == (2, 2), "values are interpolated between pixels"


def test_pixels_interpolate_the_mesh(cylinder, on_grid):
    vertices, _ = cylinder
    assert on_grid.known.all()
    np.testing.assert_allclose(on_grid.weights.sum(axis=2), 1.0)
    found = np.einsum("rck,rcki->rci", on_grid.weights, vertices[on_grid.corners])
    expected = surface_point(*np.meshgrid(on_grid.grid.x, on_grid.grid.arc, indexing="ij"))
    np.testing.assert_allclose(found, expected, atol=2e-6)  # a side's sagitta is 0.6 um


def test_frames_are_right_handed_along_finger_and_arc(on_grid):
    frames = on_grid.frames
    np.testing.assert_allclose(frames @ frames.swapaxes(2, 3), np.broadcast_to(np.eye(3), frames.shape), atol=1e-12)
    np.testing.assert_allclose(
        frames_of(np.array([[0.0, -1.0, 0.0]]))[0], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12
    )
    step = on_grid.points[:, 1:] - on_grid.points[:, :-1]
    assert (np.einsum("rci,rci->rc", step, frames[:, :-1, 2]) > 0.99 * np.linalg.norm(step, axis=2)).all()


def test_points_are_placed_by_the_foot_of_their_perpendicular(on_grid):
    generator = np.random.default_rng(0)
    x, arc = generator.uniform(-9e-3, 9e-3, 200), generator.uniform(-7e-3, 7e-3, 200)
    depth = generator.uniform(0.0, 3e-3, 200)
    found = on_grid.places(surface_point(x, arc, depth))
    np.testing.assert_allclose(found.x, x, atol=1e-6)
    np.testing.assert_allclose(found.arc, arc, atol=2e-5)
    np.testing.assert_allclose(found.offset, np.stack([-depth, 0 * depth, 0 * depth], axis=1), atol=2e-5)


def test_points_beyond_the_grid_are_placed_at_its_edge(on_grid):
    found = on_grid.places(surface_point(np.array([14e-3]), np.array([0.0])))
    assert found.x == pytest.approx(on_grid.grid.x[-1])
    assert found.offset[0, 1] == pytest.approx(14e-3 - on_grid.grid.x[-1], rel=1e-3)


def test_a_skin_ends_where_it_is_not_shown(cylinder):
    vertices, triangles = cylinder
    shown = np.abs(np.arctan2(vertices[:, 2], -vertices[:, 1])) < 0.5
    assert reach_along_arc(vertices, triangles, shown, 0.2e-3) == pytest.approx(0.5 * RADIUS, abs=0.3e-3)
    on = SkinOnGrid(vertices, triangles, shown, PixelGrid.over(-10e-3, 10e-3, 8e-3, 1e-3, 8))
    assert not on.known[:, 0].any() and on.known[:, 8].all() and (on.weights[~on.known] == 0.0).all()
