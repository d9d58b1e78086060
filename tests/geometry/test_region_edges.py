"""The edge of a region becomes edges of the mesh, whatever the region's shape."""

from functools import partial

import numpy as np
import pytest
import trimesh

from simgen.geometry.curved_tetrahedra import FREE, HELD, LabelledSurface, make_quadratic
from simgen.geometry.mesh_quality import mean_ratio, measure
from simgen.geometry.region_edges import LEAST_SHAPE, cut
from simgen.geometry.surface import ClosestPoint, patches_at, smooth_patches
from simgen.geometry.tetrahedra import signed_volumes, sizing_grid
from simgen.sensors.sensor_meshes import end_at_regions

SIDE = 10e-3  # m
HALF = 3.1e-3


def in_square(points):
    """A square of 6.2 mm in the middle of the top face."""
    return (points[:, 2] > SIDE / 2 - 1e-6) & (np.abs(points[:, :2]).max(axis=1) <= HALF)


def in_disc(points):
    return (points[:, 2] > SIDE / 2 - 1e-6) & (np.hypot(*points[:, :2].T) <= HALF)


def beside_a_line(points, at):
    """A part of the top face, divided by a slanted line."""
    return (points[:, 2] > SIDE / 2 - 1e-6) & (points[:, 0] + 0.3 * points[:, 1] <= at)


def meeting(surface):
    return patches_at(len(surface.vertices), surface.faces, smooth_patches(surface))


AREAS = [(in_square, 4.0 * HALF**2), (in_disc, np.pi * HALF**2)]


@pytest.fixture(scope="module")
def box():
    return trimesh.creation.box((SIDE,) * 3).subdivide().subdivide().subdivide().subdivide()


@pytest.fixture(scope="module")
def tetrahedra():
    """Cells of 2 mm cut into six, with corners moved by up to 0.3 mm within faces and inside.

    The mesher is not used, because its meshes differ from run to run.
    """
    half = np.full(3, SIDE / 2)
    vertices, tetrahedra = sizing_grid(-half, half, 2e-3)
    moved = np.random.default_rng(0).uniform(-0.3e-3, 0.3e-3, vertices.shape)
    return np.where(np.abs(vertices) < half - 1e-6, vertices + moved, vertices), tetrahedra


@pytest.mark.parametrize(("inside", "area"), AREAS)
def test_triangles_fill_the_region(box, inside, area):
    vertices, faces = cut(box.vertices, box.faces, box.edges_unique, inside, meeting(box), np.inf)
    parted = trimesh.Trimesh(vertices, faces, process=False)
    assert parted.is_watertight
    assert parted.volume == pytest.approx(SIDE**3, rel=1e-12)
    held = inside(parted.triangles_center)
    # Chords of 0.6 mm cut off a circle of 3.1 mm: (0.6 / 3.1)^2 / 6 = 0.6 % of its area; some are longer.
    assert parted.area_faces[held].sum() == pytest.approx(area, rel=8e-3)
    assert abs(box.area_faces[inside(box.triangles_center)].sum() / area - 1.0) > 8e-3  # what it was without


def test_tetrahedra_follow_straight_edges(box, tetrahedra):
    wrong = []
    for at in (-2.1e-3, -0.8e-3, 0.7e-3, 1.6e-3):
        inside = partial(beside_a_line, at=at)
        vertices, faces = cut(box.vertices, box.faces, box.edges_unique, inside, meeting(box), np.inf)
        surface = trimesh.Trimesh(vertices, faces, process=False)
        true = LabelledSurface(surface, np.where(inside(surface.triangles_center), HELD, FREE))
        corners, tets = end_at_regions(*tetrahedra, true)
        assert signed_volumes(corners, tets).sum() == pytest.approx(signed_volumes(*tetrahedra).sum(), rel=1e-3)
        assert mean_ratio(corners, tets).min() >= min(LEAST_SHAPE, mean_ratio(*tetrahedra).min())
        mesh, plain = (make_quadratic(*each, true, limit=1e-3) for each in ((corners, tets), tetrahedra))
        assert abs(measure(mesh, true).held_area_error) < 0.05
        wrong.append([wrong_area(mesh, inside), wrong_area(plain, inside)])
    # The lines are 10 mm long. As they come, triangles of 2 mm end 0.2 to 0.5 mm before or behind them; where neither
    # end of an edge may move, and a split would leave a sliver, it stays.
    aligned, plain = np.mean(wrong, axis=0)
    assert aligned < 0.4 * plain  # 0.29; 0.20 to 0.45 with other corners


def wrong_area(mesh, inside) -> float:
    """Area of the top that is in the region and not held, or held and not in the region, m2."""
    x = np.linspace(-0.5, 0.5, 200) * SIDE
    points = np.stack(np.meshgrid(x, x, [SIDE / 2], indexing="ij"), axis=-1).reshape(-1, 3)
    nearest = ClosestPoint(mesh.nodes, mesh.faces[:, :3])(points)[2]
    return float(((mesh.region[nearest] == HELD) != inside(points)).mean() * SIDE**2)


def test_what_lies_on_the_edge_stays(box):
    """A region that already ends at edges leaves the mesh as it is."""
    vertices, faces = cut(box.vertices, box.faces, box.edges_unique, lambda p: p[:, 0] <= 1e-9, meeting(box), np.inf)
    np.testing.assert_array_equal(vertices, box.vertices)
    np.testing.assert_array_equal(faces, box.faces)


@pytest.mark.parametrize(("height", "strip"), [(0.1, 0.0), (0.18, 0.0), (0.2, 0.2), (0.21, 0.21), (0.4, 0.4)])  # mm
def test_a_region_that_ends_close_to_a_crease_ends_at_it(box, height, strip):
    """Edges of 0.625 mm: the top and 0.18 mm of the sides are the top; 0.2 mm are a strip."""
    inside = partial(near_top, height=height * 1e-3)
    vertices, faces = cut(box.vertices, box.faces, box.edges_unique, inside, meeting(box), np.inf)
    parted = trimesh.Trimesh(vertices, faces, process=False)
    held = inside(parted.triangles_center)
    assert parted.area_faces[held].sum() == pytest.approx(SIDE**2 + 4.0 * SIDE * strip * 1e-3, rel=1e-6)


def test_a_long_triangle_does_not_stretch_what_is_close():
    """Edges of 10 mm, a strip of 1 mm: within `NEAR` of the edge, but farther than ``reach``."""
    plain = trimesh.creation.box((SIDE,) * 3)
    inside = partial(near_top, height=1e-3)
    held = {}
    for reach in (np.inf, 0.3e-3):
        vertices, faces = cut(plain.vertices, plain.faces, plain.edges_unique, inside, meeting(plain), reach)
        parted = trimesh.Trimesh(vertices, faces, process=False)
        held[reach] = parted.area_faces[inside(parted.triangles_center)].sum()
    assert held[np.inf] == pytest.approx(SIDE**2)
    assert held[0.3e-3] == pytest.approx(SIDE**2 + 4.0 * SIDE * 1e-3)


def near_top(points, height):
    return points[:, 2] >= SIDE / 2 - height


def test_patches_end_at_regions(box):
    assert smooth_patches(box).max() + 1 == 6
    left = box.triangles_center[:, 0] < 0.0
    assert smooth_patches(box, left).max() + 1 == 10  # four sides are divided
