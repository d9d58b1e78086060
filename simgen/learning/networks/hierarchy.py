"""Mesh hierarchy: the vertices of each level, their neighbours, and interpolation to the finer level.

Levels come from the graph of the tetrahedra's edges, not from a surface: a third of the BioTac's vertices and two
thirds of the DIGIT's lie inside. Distances run along the mesh, so that two skins across a gap are no neighbours.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_array, eye_array
from scipy.sparse.csgraph import dijkstra, reverse_cuthill_mckee

from simgen.geometry.interpolation import TET_EDGES

LEVELS = 5
NEIGHBOURS = 8  # sources of an interpolated value
RIDGE = 1e-6  # of moving least squares, relative to the squared mean distance: neighbours may lie in a plane
BOUND = 3.0  # of the sum of |weights|: the largest ratio of an interpolated value to its sources


@dataclass(frozen=True)
class Hierarchy:
    """Levels of a mesh, each with half the vertices of the finer level, rounded up.

    Vertices are renumbered, so that the first ``sizes[level]`` of them make a level.

    order : (vertex,) numbers in the mesh
    adjacency : for each level, (size, size), 1 between neighbours
    interpolation : for each level but the coarsest, (size - next size, next size), from values on the next level to
        the vertices that it leaves out; rows sum to 1
    """

    order: np.ndarray
    sizes: tuple[int, ...]
    adjacency: tuple[csr_array, ...]
    interpolation: tuple[csr_array, ...]


def build_hierarchy(vertices: np.ndarray, tetrahedra: np.ndarray, levels: int = LEVELS) -> Hierarchy:
    """Build the levels of a mesh of ``vertices`` (v, 3) and ``tetrahedra`` (t, 4), always in the same way.

    A level keeps the farthest points, along the mesh, from those chosen before (Gonzalez, 1985), so that it is evenly
    spread. The cell of a kept vertex holds the mesh vertices nearest to it. Vertices whose cells touch are neighbours.
    """
    graph = edge_graph(vertices, tetrahedra)
    sizes = [len(vertices)]
    for _ in range(levels - 1):
        sizes.append(-(-sizes[-1] // 2))
    order = farthest_point_order(graph, sizes[1])
    # Sparse products read from caches if neighbours of a level are near each other in memory.
    place = np.argsort(reverse_cuthill_mckee(graph, symmetric_mode=True))
    order = np.concatenate([part[np.argsort(place[part])] for part in np.split(order, sizes[:0:-1])])
    graph, points = graph[order][:, order], vertices[order]
    adjacency, interpolation = [touching(graph, np.arange(len(points)))], []
    for finer, size in pairwise(sizes):
        cells = nearest_of_first(graph, size)
        adjacency.append(touching(graph, cells))
        near = (adjacency[-1] + eye_array(size, format="csr"))[cells[size:finer]]
        interpolation.append(affine_weights(points[size:finer], points[:size], near))
    return Hierarchy(order, tuple(sizes), tuple(adjacency), tuple(interpolation))


def edge_graph(vertices: np.ndarray, tetrahedra: np.ndarray) -> csr_array:
    """Lengths of the tetrahedra's edges as a symmetric matrix (v, v)."""
    ends = np.unique(np.sort(tetrahedra[:, TET_EDGES].reshape(-1, 2), axis=1), axis=0)
    length = np.linalg.norm(vertices[ends[:, 0]] - vertices[ends[:, 1]], axis=1)
    both = np.concatenate([ends, ends[:, ::-1]])
    return csr_array((np.tile(length, 2), (both[:, 0], both[:, 1])), shape=(len(vertices), len(vertices)))


def farthest_point_order(graph: csr_array, count: int) -> np.ndarray:
    """Order all vertices: first ``count`` farthest points along the edges, then the rest."""
    distance = np.full(graph.shape[0], np.inf)
    chosen = []
    for _ in range(count):
        chosen.append(int(distance.argmax()))
        reached = dijkstra(graph, indices=chosen[-1], limit=distance[chosen[-1]])
        distance = np.minimum(distance, reached)
    return np.concatenate([chosen, np.setdiff1d(np.arange(len(distance)), chosen)])


def nearest_of_first(graph: csr_array, size: int) -> np.ndarray:
    """Nearest of the first ``size`` vertices along the edges, for each vertex."""
    _, _, source = dijkstra(graph, indices=np.arange(size), min_only=True, return_predecessors=True)
    return source


def touching(graph: csr_array, cells: np.ndarray) -> csr_array:
    """Adjacency of cells that an edge joins; ``cells`` (vertex,) holds the cell of each vertex."""
    edges = graph.tocoo()
    pairs = np.unique(np.stack([cells[edges.row], cells[edges.col]]), axis=1)
    pairs = pairs[:, pairs[0] != pairs[1]]
    size = cells.max() + 1
    return csr_array((np.ones(pairs.shape[1]), (pairs[0], pairs[1])), shape=(size, size))


def affine_weights(points: np.ndarray, sources: np.ndarray, near: csr_array) -> csr_array:
    """Weights (p, s) that interpolate from ``sources`` (s, 3) to ``points`` (p, 3), exactly for affine fields.

    Moving least squares (Lancaster and Salkauskas, 1981) with weights 1 / distance^2, from the nearest `NEIGHBOURS` of
    the sources that ``near`` (p, s) allows. A ridge keeps the sum of |weights| below `BOUND` where all sources lie to
    one side of a point.
    """
    rows = np.repeat(np.arange(len(points)), np.diff(near.indptr))
    distance = np.linalg.norm(points[rows] - sources[near.indices], axis=1)
    by_distance = np.lexsort([distance, rows])
    rank = np.arange(len(rows)) - near.indptr[rows]
    used = by_distance[rank < NEIGHBOURS]
    rows, columns, rank, distance = rows[used], near.indices[used], rank[rank < NEIGHBOURS], distance[used]

    scale = (np.bincount(rows, distance) / np.bincount(rows))[rows]
    trust = np.zeros((len(points), NEIGHBOURS))  # stays 0 where a point has fewer neighbours
    basis = np.zeros((len(points), NEIGHBOURS, 4))
    trust[rows, rank] = (scale / distance) ** 2
    basis[rows, rank, 0] = 1.0
    basis[rows, rank, 1:] = (sources[columns] - points[rows]) / scale[:, None]
    weights = _bounded(basis, trust)
    return csr_array((weights[rows, rank], (rows, columns)), shape=near.shape)


def _bounded(basis: np.ndarray, trust: np.ndarray) -> np.ndarray:
    """Weights (p, n) of the affine fit at the origin; ``basis`` (p, n, 4) is 1, x, y, z of the neighbours."""
    weights = np.zeros(trust.shape)
    todo, ridge = np.arange(len(trust)), RIDGE
    while len(todo):
        trusted = basis[todo] * trust[todo, :, None]
        normal = np.einsum("pni,pnj->pij", basis[todo], trusted)
        normal[:, [1, 2, 3], [1, 2, 3]] += ridge * trust[todo].sum(axis=1)[:, None]
        at_origin = np.linalg.inv(normal)[:, :, :1]
        found = (trusted @ at_origin)[:, :, 0]
        weights[todo] = found / found.sum(axis=1, keepdims=True)
        todo = todo[np.abs(weights[todo]).sum(axis=1) > BOUND]
        ridge *= 10.0  # tends to a mean with positive weights
    return weights
