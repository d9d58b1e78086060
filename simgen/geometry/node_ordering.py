"""Node ordering: numbers nodes and elements so that neighbours in space are neighbours in memory.

A mesher numbers nodes arbitrarily. In reverse Cuthill-McKee order, elements that run at the same time share most of
their nodes, and read them from a cache.
"""

from dataclasses import replace

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee

from simgen.geometry.interpolation import TET_EDGES
from simgen.geometry.tetrahedra import SimulationMesh


def in_cuthill_mckee_order(mesh: SimulationMesh) -> SimulationMesh:
    """The same mesh with its corner nodes in reverse Cuthill-McKee order (ACM National Conference 1969).

    Mid-edge nodes, elements and faces follow by the mean place of their corners.
    """
    n, n_corners, corners = len(mesh.nodes), mesh.n_corners, mesh.tetrahedra[:, :4]
    a, b = (corners[:, ends].ravel() for ends in TET_EDGES.T)
    graph = sparse.csr_array((np.ones(len(a)), (a, b)), shape=(n_corners, n_corners))
    place = np.full(n, np.inf)
    place[reverse_cuthill_mckee(sparse.csr_matrix(graph + graph.T), symmetric_mode=True)] = np.arange(n_corners)
    place[mesh.tetrahedra[:, 4:]] = place[corners[:, TET_EDGES]].mean(axis=-1)
    order = np.concatenate([np.argsort(place[:n_corners]), n_corners + np.argsort(place[n_corners:], kind="stable")])
    new = np.empty(n, dtype=np.int32)
    new[order] = np.arange(n, dtype=np.int32)

    def elements(nodes: np.ndarray, n_own: int) -> np.ndarray:
        return new[nodes[np.argsort(place[nodes[:, :n_own]].mean(axis=1), kind="stable")]]

    return replace(
        mesh,
        nodes=mesh.nodes[order],
        held=mesh.held[order],
        tetrahedra=elements(mesh.tetrahedra, 4),
        touchable=elements(mesh.touchable, 3),
        facing_core=elements(mesh.facing_core, 3),
    )
