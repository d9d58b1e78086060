"""The edge of a region of a surface, made edges of a mesh: a held patch ends where it ends, not at the next element.

Between a corner inside the region and one outside, the nearer corner moves to the region's edge where it is close; an
edge that is still crossed is split there. (Warping before cutting keeps elements well shaped: Labelle and Shewchuk,
"Isosurface stuffing", ACM TOG 26, 2007.)
"""

from collections.abc import Callable

import numpy as np

from simgen.geometry.mesh_quality import mean_ratio

NEAR = 0.3  # of an edge: a corner closer than this to the crossing may stand for it; below 1/3, where centres are
AT = 0.02  # of an edge: a corner closer than this is there already
THIN = 0.15  # of an edge: no tetrahedron's edge is split closer to its ends
LEAST_SHAPE = 0.3  # mean ratio that moving a corner or splitting an edge must leave: what fTetWild guarantees
BISECTIONS = 30

Inside = Callable[[np.ndarray], np.ndarray]  # points (n, 3) -> (n,) bool: which are in the region


def cut(
    vertices: np.ndarray, faces: np.ndarray, edges: np.ndarray, inside: Inside, meeting: list[set[int]], reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """The same surface with its triangles split where a region ends: vertices (v', 3), faces (f', 3).

    edges (e, 2): all of them. meeting: smooth patches at each vertex. A region that ends close to a crease of the body,
    where two of them meet, ends at it: within `NEAR` of an edge, but no longer a way than ``reach``. What lies between
    two corners is not seen: a region narrower than a triangle is what the triangles' centres say.
    """
    crossed, share = _crossings(vertices, edges, inside, 0.0)
    stays = np.array([[not meeting[a] <= meeting[b], not meeting[b] <= meeting[a]] for a, b in crossed]).reshape(-1, 2)
    length = np.linalg.norm(np.diff(vertices[crossed], axis=1)[:, 0], axis=1)[:, None]
    close = np.where(stays, np.maximum(np.minimum(NEAR, reach / length), AT), AT)
    apart = (share > close[:, 0]) & (1.0 - share > close[:, 1])
    for (a, b), t in zip(crossed[apart], share[apart], strict=True):
        vertices, faces = _split(vertices, faces, a, b, (1.0 - t) * vertices[a] + t * vertices[b])
    return vertices, faces


def align(
    vertices: np.ndarray, tetrahedra: np.ndarray, edges: np.ndarray, inside: Inside, meeting: list[set[int]]
) -> tuple[np.ndarray, np.ndarray]:
    """Tetrahedra whose surface edges end where a region does: vertices (v', 3), tetrahedra (t', 4).

    edges (e, 2): those on the surface. meeting: smooth patches at each corner. One on a crease stays on it. An
    edge stays crossed where neither a move nor a split leaves well-shaped elements.
    """
    vertices, tetrahedra = np.array(vertices), np.array(tetrahedra)
    crossed, share = _crossings(vertices, edges, inside, 0.0)
    settled = _warp(vertices, tetrahedra, crossed, share, inside, meeting)
    crossed, share = _crossings(vertices, crossed[~settled], inside, THIN)
    for (a, b), t in zip(crossed, share, strict=True):
        point = (1.0 - t) * vertices[a] + t * vertices[b]
        more, finer = _split(vertices, tetrahedra, a, b, point)
        both = (tetrahedra == a).any(axis=1) & (tetrahedra == b).any(axis=1)
        before = mean_ratio(vertices, tetrahedra[both]).min()
        if mean_ratio(more, finer[(finer == len(vertices)).any(axis=1)]).min() >= min(LEAST_SHAPE, before):
            vertices, tetrahedra = more, finer
    return vertices, tetrahedra


def _crossings(vertices, edges, inside, off: float) -> tuple[np.ndarray, np.ndarray]:
    """Edges with one end inside, and where along each (share from its first end) the region ends, by bisection.

    Ends are looked at ``off`` (a share of the edge) from the corners, which may lie on the region's edge themselves;
    what is crossed closer to them stays.
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
    """Move close corners to their nearest crossing, in place; which of the crossed edges are settled by that."""
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


def _split(vertices, simplices, a, b, point) -> tuple[np.ndarray, np.ndarray]:
    """Split edge a-b at a point, and with it every triangle or tetrahedron that has it; the point is the last vertex.
    """
    both = (simplices == a).any(axis=1) & (simplices == b).any(axis=1)
    new, first, second = len(vertices), simplices[both], simplices[both]
    first[first == b] = new
    second[second == a] = new
    return np.vstack([vertices, point]), np.concatenate([simplices[~both], first, second])
