"""Mirror images: of meshes that are symmetric, of electrodes, and none for others."""

import numpy as np
import pytest
import torch
from scipy.spatial import Delaunay

from simgen.learning.networks.mirror import IMAGE, SAME_M, Mirror, interpolation

CPU = torch.device("cpu")
ELECTRODES = 1e-3 * np.array([[1.0, 0.0, 0.5], [1.0, 0.0, -0.5], [-1.0, 0.0, 0.0]])


def mesh() -> tuple[np.ndarray, np.ndarray]:
    """Points in a box, of 4 mm along z; the surface is symmetric, the points within are not."""
    random = np.random.default_rng(0)
    corners = np.array([[x, y, z] for x in (-2.0, 2.0) for y in (-1.0, 1.0) for z in (-2.0, 2.0)])
    points = 1e-3 * np.concatenate([corners, random.uniform(-0.99, 0.99, (60, 3)) * [2.0, 1.0, 2.0]])
    tetrahedra = Delaunay(points).simplices
    edges = points[tetrahedra[:, 1:]] - points[tetrahedra[:, :1]]
    return points, tetrahedra[np.abs(np.linalg.det(edges)) > 1e-15]  # not those that are flat in a face of the box


def test_linear_fields_have_exact_mirror_images():
    rest, tetrahedra = mesh()
    mirror = Mirror.of_sensor(rest, tetrahedra, ELECTRODES, CPU)
    field = np.random.default_rng(1).normal(size=(2, 3, 3))
    u = torch.from_numpy(np.einsum("nij,vj->nvi", field, rest)).float()
    expected = np.einsum("nij,vj->nvi", field, rest * IMAGE) * IMAGE
    np.testing.assert_allclose(mirror.displacements(u), expected, rtol=0.0, atol=1e-8)


def test_electrodes_change_places():
    rest, tetrahedra = mesh()
    assert Mirror.of_sensor(rest, tetrahedra, ELECTRODES, CPU).partner.tolist() == [1, 0, 2]


@pytest.mark.parametrize("part", ["mesh", "electrodes"])
def test_a_sensor_that_is_not_symmetric_has_none(part):
    rest, tetrahedra = mesh()
    moved = {"mesh": rest.copy(), "electrodes": ELECTRODES.copy()}
    moved[part][0] += [0.0, 0.0, -3.0 * SAME_M]
    assert Mirror.of_sensor(moved["mesh"], tetrahedra, moved["electrodes"], CPU) is None


def test_points_outside_are_told():
    rest, tetrahedra = mesh()
    matrix, outside = interpolation(rest, tetrahedra, np.array([[0.0, 0.0, 0.0], [2.1e-3, 0.0, 0.0]]))
    assert outside[0] == pytest.approx(0.0, abs=1e-12) and outside[1] >= 0.1e-3 - 1e-12
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0)
    assert matrix.data.min() >= 0.0
