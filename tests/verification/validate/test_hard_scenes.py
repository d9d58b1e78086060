"""The block and the paths of the hard cases."""

import math

import numpy as np

from simgen.verification.validate.hard_scenes import COUNTS, SIZE_MM, block, down, sideways


def test_paths_in_metres():
    np.testing.assert_allclose(down(0.4, 2), [[0.0, 2e-4, 0.0], [0.0, 4e-4, 0.0]])
    np.testing.assert_allclose(sideways(1.0, 0.2, 2), [[1e-4, 1e-3, 0.0], [2e-4, 1e-3, 0.0]])


def test_the_block_is_bonded_at_its_bottom():
    mesh = block().simulation_mesh
    assert mesh.held.sum() == (mesh.nodes[:, 1] > 1e-3 * (SIZE_MM[1] - 1e-6)).sum() > 0
    assert len(mesh.tetrahedra) == 6 * math.prod(COUNTS)
