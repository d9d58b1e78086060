"""A structured box of tetrahedra, small and exact: no mesher is needed to test the solver."""

from itertools import permutations

import numpy as np

from simgen.fem.element import TET_EDGES


def box(counts=(3, 2, 3), size=(6.0, 4.0, 6.0)):
    """Kuhn's six tetrahedra per cell, with mid-edge nodes; the top y = 0 faces -y, the bottom is at y = size[1].

    Returns nodes (n, 3), tetrahedra (e, 10), number of corners, and the boundary faces (f, 6), outward.
    """
    grid = [np.linspace(0.0, s, c + 1) for s, c in zip(size, counts, strict=True)]
    corners = np.stack(np.meshgrid(*grid, indexing="ij"), axis=-1).reshape(-1, 3)
    corners[:, [0, 2]] -= np.array([size[0], size[2]]) / 2.0
    index = np.arange(len(corners)).reshape([c + 1 for c in counts])
    tets = []
    for order in permutations(range(3)):
        path = [np.zeros(3, dtype=int)]
        for axis in order:
            path.append(path[-1] + np.eye(3, dtype=int)[axis])
        sign = np.linalg.det(np.diff(np.array(path), axis=0))
        path = path if sign > 0 else [path[0], path[2], path[1], path[3]]
        cells = [index[tuple(slice(o, o + c) for o, c in zip(p, counts, strict=True))].ravel() for p in path]
        tets.append(np.stack(cells, axis=1))
    tets = np.concatenate(tets)
    edges, inverse = np.unique(np.sort(tets[:, TET_EDGES].reshape(-1, 2), axis=1), axis=0, return_inverse=True)
    nodes = np.vstack([corners, corners[edges].mean(axis=1)])
    tets = np.hstack([tets, len(corners) + inverse.reshape(-1, 6)]).astype(np.int32)
    local = [[1, 2, 3, 5, 9, 8], [0, 3, 2, 7, 9, 6], [0, 1, 3, 4, 8, 7], [0, 2, 1, 6, 5, 4]]
    faces = np.concatenate([tets[:, f] for f in local])
    _, first, count = np.unique(np.sort(faces[:, :3], axis=1), axis=0, return_index=True, return_counts=True)
    return nodes, tets, len(corners), faces[first[count == 1]]


def top(nodes, faces):
    return faces[(np.abs(nodes[faces][:, :, 1]) < 1e-9).all(axis=1)]
