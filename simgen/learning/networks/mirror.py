"""Mirror images of samples, of a sensor that is its own mirror image in z = 0. Networks learn from them, too."""

from typing import Self

import numpy as np
import torch
from scipy.sparse import csr_array
from scipy.spatial import cKDTree
from torch import Tensor

from simgen.geometry.interpolation import TET_EDGES, locate
from simgen.learning.networks.sparse import SparseMatrix, multiply

IMAGE = np.array([1.0, 1.0, -1.0])
# A sensor is symmetric if mirrored vertices are no farther outside of its mesh, and mirrored electrodes no farther from
# an electrode. Mirrored vertices of the BioTac are up to 0.06 mm outside, on facets.
SAME_M = 0.2e-3


class Mirror:
    """Mirror images of one sensor's displacements and electrode signals.

    matrix : (vertex, vertex) interpolates displacements of the mesh at the mirrored vertices
    partner : (electrode,) the electrode at each electrode's mirrored place
    """

    def __init__(self, matrix: csr_array, partner: np.ndarray, device: torch.device):
        self._matrix = SparseMatrix(*matrix.shape, matrix.nnz).to(device)
        self._matrix.fill(matrix)
        self.partner = torch.from_numpy(partner).to(device)

    @classmethod
    def of_sensor(
        cls, rest: np.ndarray, tetrahedra: np.ndarray, electrodes: np.ndarray, device: torch.device
    ) -> Self | None:
        """Make the mirror of a mesh (v, 3), (t, 4) with electrodes (e, 3), m; None if they are not symmetric."""
        away, partner = cKDTree(electrodes).query(electrodes * IMAGE)
        paired = away.max() <= SAME_M and np.array_equal(partner[partner], np.arange(len(partner)))
        if not paired or not is_symmetric(rest, tetrahedra):
            return None
        return cls(interpolation(rest, tetrahedra, rest * IMAGE)[0], partner, device)

    def displacements(self, u: Tensor) -> Tensor:
        """Mirror images (n, vertex, 3), m, of displacements."""
        by_vertex = u.permute(1, 2, 0).flatten(1).contiguous()
        out = torch.empty_like(by_vertex)
        multiply(self._matrix, by_vertex, out)
        return out.unflatten(1, (3, -1)).permute(2, 0, 1) * u.new_tensor(IMAGE)


def is_symmetric(rest: np.ndarray, tetrahedra: np.ndarray) -> bool:
    """Return True if the mirror images of a mesh's vertices (v, 3), m, lie within the mesh (t, 4)."""
    return bool(interpolation(rest, tetrahedra, rest * IMAGE)[1].max() <= SAME_M)


def interpolation(rest: np.ndarray, tetrahedra: np.ndarray, points: np.ndarray) -> tuple[csr_array, np.ndarray]:
    """Linear interpolation (point, vertex) in a mesh, and the distances (point,), m, of points outside of it.

    A point outside takes the values at the nearest point of the mesh.
    """
    corners = rest[tetrahedra]
    nodes = np.concatenate([corners, corners[:, TET_EDGES].mean(axis=2)], axis=1)  # ten of each straight tetrahedron
    numbers = np.arange(10 * len(tetrahedra)).reshape(-1, 10)
    element, barycentric, distance = locate(nodes.reshape(-1, 3), numbers, points)
    starts = 4 * np.arange(len(points) + 1)
    shape = len(points), len(rest)
    return csr_array((barycentric.ravel(), tetrahedra[element].ravel(), starts), shape), distance
