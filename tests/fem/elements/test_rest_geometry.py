"""Rest geometry for the operators: the metric of the geometry map, kept for meshes that come again."""

import numpy as np
import pytest
from simulation.blocks import make_block

from simgen.fem.elements.element import P2P1
from simgen.fem.elements.rest_geometry import rest_geometries


@pytest.fixture(scope="module")
def mesh():
    return make_block((2, 2, 2)).simulation_mesh


def test_the_metric_is_that_of_the_geometry_map(mesh):
    for rest, points in zip(rest_geometries(P2P1, mesh.nodes, mesh.tetrahedra), (8, 4), strict=True):
        inverse = rest.tets.inverse
        assert inverse.shape == (len(mesh.tetrahedra), points, 3, 3)
        np.testing.assert_allclose(rest.metric, inverse @ inverse.swapaxes(2, 3), rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(rest.contraction, np.linalg.det(inverse), rtol=1e-12)
        np.testing.assert_allclose(rest.contraction * rest.tets.volumes.sum(axis=1, keepdims=True), 1.0 / 6.0)
        mean = (rest.tets.volumes[..., None, None] * rest.metric).sum(axis=1)
        np.testing.assert_allclose(rest.mean_metric, mean, rtol=1e-12, atol=1e-12)


def test_a_mesh_that_comes_again_is_not_computed_again_but_a_moved_one_is(mesh):
    first = rest_geometries(P2P1, mesh.nodes, mesh.tetrahedra)
    assert rest_geometries(P2P1, mesh.nodes.copy(), mesh.tetrahedra.copy()) is first
    moved = rest_geometries(P2P1, 2.0 * mesh.nodes, mesh.tetrahedra)
    np.testing.assert_allclose(moved[0].tets.volumes, 8.0 * first[0].tets.volumes)
