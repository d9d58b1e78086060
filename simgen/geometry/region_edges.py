"""Alignment of a mesh with the edge of a region, so that a held patch ends where sensor.yaml says.

Where a mesh edge crosses the region's edge, a corner that is close moves onto it. Other crossed edges are split there.
Warping before cutting keeps elements well shaped (Labelle and Shewchuk, "Isosurface stuffing", ACM TOG 26, 2007).
"""

from collections.abc import Callable

import numpy as np

from simgen.geometry.mesh_quality import mean_ratio

# Distances from a corner to the crossing, as shares of the mesh edge:
NEAR = 0.3  # the corner may move to the crossing; less than 1/3, where the centre of a triangle lies
AT = 0.02  # the corner counts as on the region's edge
THIN = 0.15  # no tetrahedron's edge is split closer to a corner
LEAST_SHAPE = 0.3  # mean ratio after a move or a split, at least: what fTetWild guarantees
BISECTIONS = 30

Inside = Callable[[np.ndarray], np.ndarray]  # points (n, 3) -> (n,) bool, True in the region


def cut(
    vertices: np.ndarray, faces: np.ndarray, edges: np.ndarray, inside: Inside, meeting: list[set[int]], reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """Split the triangles of a surface where a region ends: vertices (v', 3), faces (f', 3).

    edges: (e, 2) all edges of the surface.
    meeting: labels of the smooth patches at each vertex; two or more on a crease.
    reach: m. A region that ends closer to a crease than this, and than `NEAR` times the mesh edge, ends at the crease.

    A region narrower than a triangle is not seen between two corners.
    """
    crossed, share = _crossings(vertices, edges, inside, 0.0)
    stays = np.array([[not meeting[a] <= meeting[b], not meeting[b] <= meeting[a]] for a, b in crossed]).reshape(-1, 2)
    length = np.linalg.norm(np.diff(vertices[crossed], axis=1)[:, 0], axis=1)[:, None]
    close = np.where(stays, np.maximum(np.minimum(NEAR, reach / length), AT), AT)
    apart = (share > close[:, 0]) & (1.0 - share > close[:, 1])
    split, share = crossed[apart], share[apart][:, None]
    points = (1.0 - share) * vertices[split[:, 0]] + share * vertices[split[:, 1]]
    affected = np.isin(faces, split).sum(axis=1) >= 2  # only these can have an edge that is split
    pieces, whole = faces[affected], np.flatnonzero(affected)  # face number of each piece; -1 for a part of a face
    for new, (a, b) in enumerate(split, len(vertices)):
        pieces, both = _split(pieces, a, b, new)
        whole = np.concatenate([whole[~both], np.full(2 * both.sum(), -1)])
    kept = ~affected
    kept[whole[whole >= 0]] = True
    return np.vstack([vertices, points]), np.concatenate([faces[kept], pieces[whole < 0]])


def align(
    vertices: np.ndarray, tetrahedra: np.ndarray, edges: np.ndarray, inside: Inside, meeting: list[set[int]]
) -> tuple[np.ndarray, np.ndarray]:
    """Align the surface edges of tetrahedra with the edge of a region: vertices (v', 3), tetrahedra (t', 4).

    edges: (e, 2) edges on the surface.
    meeting: labels of the smooth patches at each corner; a corner on a crease stays on it.

    An edge stays crossed if neither a move nor a split leaves well-shaped elements.
    """
    vertices, tetrahedra = np.array(vertices), np.array(tetrahedra)
    crossed, share = _crossings(vertices, edges, inside, 0.0)
    settled = _warp(vertices, tetrahedra, crossed, share, inside, meeting)
    crossed, share = _crossings(vertices, crossed[~settled], inside, THIN)
    for (a, b), t in zip(crossed, share, strict=True):
        point = (1.0 - t) * vertices[a] + t * vertices[b]
        more, (finer, both) = np.vstack([vertices, point]), _split(tetrahedra, a, b, len(vertices))
        before = mean_ratio(vertices, tetrahedra[both]).min()
        if mean_ratio(more, finer[(finer == len(vertices)).any(axis=1)]).min() >= min(LEAST_SHAPE, before):
            vertices, tetrahedra = more, finer
    return vertices, tetrahedra


def _crossings(vertices, edges, inside, off: float) -> tuple[np.ndarray, np.ndarray]:
    """Find edges (k, 2) with one end inside, and where on each the region ends: share (k,) of it from its first end.

    Ends are tested ``off`` (a share of the edge) away from the corners, which may lie on the region's edge. Crossings
    closer to a corner are not found.
    """
    a, b = vertices[edges[:, 0]], vertices[edges[:, 1]]
    first = inside(a + off * (b - a))
    found = first != inside(b - off * (b - a))
    a, b, first = a[found], b[found], first[found]
    low, high = np.full(len(a), off), np.full(len(a), 1.0 - off)
    for _ in range(BISECTIONS if len(a) else 0):
        middle = 0.5 * (low + high)
        same = inside(a + middle[:, None] * (b - a)) == first
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return edges[found], 0.5 * (low + high)


def _warp(vertices, tetrahedra, crossed, share, inside, meeting) -> np.ndarray:
    """Move close corners to their nearest crossing, in place. Returns (k,) bool, True for edges no longer crossed."""
    there, settled = np.zeros(len(vertices), dtype=bool), np.zeros(len(crossed), dtype=bool)
    away = np.stack([share, 1.0 - share], axis=1).ravel()
    points = (1.0 - share)[:, None] * vertices[crossed[:, 0]] + share[:, None] * vertices[crossed[:, 1]]
    for k in np.argsort(away, kind="stable"):
        edge = k // 2
        c, other = crossed[edge][[k % 2, 1 - k % 2]]
        if away[k] > NEAR:
            break
        ends = vertices[other] + np.array([[THIN], [1.0]]) * (vertices[c] - vertices[other])
        if there[c] or (there[other] and np.equal(*inside(ends))):
            settled[edge] = True
            continue
        if away[k] > AT and meeting[c] <= meeting[other]:  # along a crease, not off it
            around = tetrahedra[(tetrahedra == c).any(axis=1)]
            before, old = mean_ratio(vertices, around).min(), vertices[c].copy()
            vertices[c] = points[edge]
            if mean_ratio(vertices, around).min() < min(LEAST_SHAPE, before):
                vertices[c] = old
                continue
        there[c] = settled[edge] = True
    return settled


def _split(simplices: np.ndarray, a: int, b: int, new: int) -> tuple[np.ndarray, np.ndarray]:
    """Split edge a-b, and every triangle or tetrahedron that has it, at a new vertex.

    Returns the others and then the halves, and the mask of those that were split.
    """
    both = (simplices == a).any(axis=1) & (simplices == b).any(axis=1)
    first, second = simplices[both], simplices[both]
    first[first == b] = new
    second[second == a] = new
    return np.concatenate([simplices[~both], first, second]), both
