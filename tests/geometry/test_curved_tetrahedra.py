"""Curved elements follow the true surface, keep sharp edges and do not fold."""

import numpy as np
import pytest
import trimesh

from simgen.geometry.curved_tetrahedra import FREE, HELD, LabelledSurface, determinants, make_quadratic
from simgen.geometry.mesh_quality import measure
from simgen.geometry.surface import smooth_patches
from simgen.geometry.tetrahedra import tetrahedralize


@pytest.fixture(scope="module")
def cylinder():
    """A fine cylinder along z, radius 5 mm, height 4 mm: held below, and coarse tetrahedra inside it.

    The mesher makes another mesh each time. In a few meshes some elements would fold and stay straight, which costs
    0.15 % of the held area.
    """
    surface = trimesh.creation.cylinder(5e-3, 4e-3, sections=128)
    surface = surface.subdivide().subdivide()
    below = surface.triangles_center[:, 2] < -2e-3 + 1e-9
    true = LabelledSurface(surface, np.where(below, HELD, FREE))
    for _ in range(5):
        vertices, tetrahedra = tetrahedralize(surface, 2.5e-3, envelope=2e-4)
        mesh = make_quadratic(vertices, tetrahedra, true, limit=1e-3)
        if mesh.straightened == 0:
            break
    return true, vertices, tetrahedra, mesh


def test_boundary_nodes_lie_on_the_true_surface(cylinder):
    true, _, _, mesh = cylinder
    _, distance, _ = true.closest(mesh.nodes[np.unique(mesh.faces)])
    assert (distance < 1e-8).mean() > 0.97  # m; the others belong to elements that would have folded
    assert distance.max() < 2e-4


def test_the_edge_between_top_and_wall_stays_sharp(cylinder):
    _, _, _, mesh = cylinder
    on_top = np.unique(mesh.faces[(mesh.nodes[mesh.faces][:, :, 2] > 2e-3 - 1e-9).all(axis=1)])
    on_wall = np.unique(mesh.faces[np.abs(mesh.nodes[mesh.faces][:, :, 2]).min(axis=1) < 1.5e-3])
    rim = np.intersect1d(on_top, on_wall)
    radius = np.linalg.norm(mesh.nodes[rim, :2], axis=1)
    assert len(rim) > 10
    # A facet of the 128-sided true surface lies up to 5 mm (1 - cos(pi / 128)) = 1.5 um inside the circle.
    assert (np.abs(radius - 5e-3) < 2e-6).mean() > 0.95


def test_curving_removes_most_of_the_volume_that_straight_elements_miss(cylinder):
    true, vertices, tetrahedra, mesh = cylinder
    straight = make_quadratic(vertices, tetrahedra, true, limit=1e-3, least_det=np.inf)
    assert straight.straightened > 0
    assert abs(measure(mesh, true).volume_error) < 0.1 * abs(measure(straight, true).volume_error)


def test_edges_of_a_mesh_with_many_vertices_are_found(cylinder):
    """Numbers of two vertices make one number, which 32 bits hold only up to 46,340 vertices. Most here are unused."""
    true, vertices, tetrahedra, mesh = cylinder
    half, unused = len(vertices) // 2, np.zeros((60_000, 3))
    number = np.arange(len(mesh.nodes)) + np.where(np.arange(len(mesh.nodes)) < half, 0, len(unused))
    spread = np.concatenate([vertices[:half], unused, vertices[half:]])
    numbered = make_quadratic(spread, number[tetrahedra].astype(np.int32), true, limit=1e-3)
    np.testing.assert_array_equal(numbered.tetrahedra, number[mesh.tetrahedra])
    np.testing.assert_array_equal(numbered.faces, number[mesh.faces])
    np.testing.assert_array_equal(numbered.nodes[number], mesh.nodes)


def test_no_element_folds(cylinder):
    _, _, _, mesh = cylinder
    assert determinants(mesh.nodes, mesh.tetrahedra).min() >= 0.2


def test_regions_come_from_the_true_surface(cylinder):
    true, _, _, mesh = cylinder
    low = (mesh.nodes[mesh.faces][:, :, 2] < -2e-3 + 1e-9).all(axis=1)
    np.testing.assert_array_equal(mesh.region == HELD, low)
    assert abs(measure(mesh, true).held_area_error) < 1e-3


def test_patches_of_a_cylinder(cylinder):
    assert smooth_patches(cylinder[0].surface).max() + 1 == 3
