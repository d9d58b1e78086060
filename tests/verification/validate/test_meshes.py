"""The structured meshes: volumes, areas and orientation of faces."""

import numpy as np
import pytest

from simgen.fem.elements.element import P2P1, TET_EDGES, face_geometry, tet_geometry
from simgen.verification.validate.meshes import box, faces_on, faces_on_sphere, on_plane, perturbed, sphere_shell, top


def flux_of_position(mesh):
    """Volume by the divergence theorem from the boundary's corners; positive for outward faces."""
    corners = mesh.nodes[mesh.faces[:, :3]]
    return np.linalg.det(corners).sum() / 6.0


def test_box_fills_its_size_and_its_faces_look_outward():
    mesh = box((3, 2, 4), (6.0, 4.0, 5.0))
    assert tet_geometry(P2P1, mesh.nodes, mesh.tetrahedra).volumes.sum() == pytest.approx(120.0, rel=1e-14)
    assert flux_of_position(mesh) == pytest.approx(120.0, rel=1e-14)
    assert face_geometry(P2P1, mesh.nodes, top(mesh.nodes, mesh.faces)).areas.sum() == pytest.approx(30.0, rel=1e-14)
    assert len(mesh.nodes) == 7 * 5 * 9  # corners, and the middles of all edges


def test_middles_lie_half_way_between_their_corners():
    mesh = box()
    ends = mesh.nodes[mesh.tetrahedra[:, [0, 1]]].mean(axis=1)
    np.testing.assert_allclose(mesh.nodes[mesh.tetrahedra[:, 4]], ends, atol=1e-15)


@pytest.mark.parametrize("around, through", [(1, 1), (2, 3), (4, 2)])
def test_shell_is_an_octant_with_its_planes_in_place(around, through):
    mesh = sphere_shell(around, through, (1.0, 2.0))
    assert (tet_geometry(P2P1, mesh.nodes, mesh.tetrahedra).volumes > 0.0).all()
    for level, area in ((1.0, np.pi / 2.0), (2.0, 2.0 * np.pi)):
        faces = faces_on_sphere(mesh, level)
        np.testing.assert_allclose(np.linalg.norm(mesh.nodes[faces], axis=2), level, rtol=1e-14)
        assert len(faces) == around**2
        assert face_geometry(P2P1, mesh.nodes, faces).areas.sum() == pytest.approx(area, rel=0.2 / around**4)
    for axis in range(3):
        assert len(faces_on(mesh.faces, on_plane(mesh.nodes, axis, 0.0))) == 2 * around * through
    assert len(mesh.faces) == 2 * around**2 + 6 * around * through
    assert flux_of_position(mesh) > 0.0


def test_straight_shell_loses_volume_that_the_curved_one_keeps():
    exact = np.pi / 6.0 * 7.0
    error = {}
    for straight in (True, False):
        mesh = sphere_shell(4, 2, (1.0, 2.0), straight)
        error[straight] = abs(tet_geometry(P2P1, mesh.nodes, mesh.tetrahedra).volumes.sum() / exact - 1.0)
    assert error[False] < 2e-3 < 5e-2 < error[True]


def test_perturbed_elements_are_irregular_and_curved_and_not_inverted():
    rest = box()
    mesh = perturbed(rest, shift=0.3, bend=0.1)
    geometry = tet_geometry(P2P1, mesh.nodes, mesh.tetrahedra)
    assert geometry.volumes.min() > 0.0
    assert np.ptp(geometry.volumes.sum(axis=1)) > 0.5 * geometry.volumes.sum(axis=1).mean()
    ends = mesh.nodes[mesh.tetrahedra[:, [0, 1]]].mean(axis=1)
    assert np.abs(mesh.nodes[mesh.tetrahedra[:, 4]] - ends).max() > 0.05
    np.testing.assert_array_equal(mesh.nodes, perturbed(rest, shift=0.3, bend=0.1).nodes)


def test_a_perturbation_inside_leaves_the_boundary_and_straight_edges_straight():
    rest = box()
    mesh = perturbed(rest, shift=0.3, bend=0.0, inside_only=True)
    outside = np.unique(mesh.faces)
    np.testing.assert_array_equal(mesh.nodes[outside], rest.nodes[outside])
    moved = np.setdiff1d(np.arange(len(mesh.nodes)), outside)
    assert np.abs(mesh.nodes[moved] - rest.nodes[moved]).max() > 0.1
    for edge, (i, j) in enumerate(TET_EDGES):
        middle = mesh.nodes[mesh.tetrahedra[:, [i, j]]].mean(axis=1)
        np.testing.assert_allclose(mesh.nodes[mesh.tetrahedra[:, 4 + edge]], middle, atol=1e-14)
