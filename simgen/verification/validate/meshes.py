"""Structured meshes of ten-node tetrahedra, made without a mesher and thus the same on all machines."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from simgen.geometry.interpolation import TET_EDGES
from simgen.geometry.tetrahedra import boundary_triangles, sizing_grid

QUADRATIC_FACES = np.array([[1, 2, 3, 5, 9, 8], [0, 3, 2, 7, 9, 6], [0, 1, 3, 4, 8, 7], [0, 2, 1, 6, 5, 4]])  # outward
ON = 1e-9  # mm, distance up to which a node is on a plane


class Mesh(NamedTuple):
    """Mesh of a body at rest.

    nodes : (n, 3) mm, corners first
    tetrahedra : (e, 10) int32, VTK's order, positive volume
    n_corners : nodes[:n_corners] are corners
    faces : (f, 6) int32, quadratic triangles of the boundary, outward
    """

    nodes: np.ndarray
    tetrahedra: np.ndarray
    n_corners: int
    faces: np.ndarray


def quadratic(
    parameters: np.ndarray,
    tetrahedra: np.ndarray,
    place: Callable[[np.ndarray], np.ndarray] = lambda parameters: parameters,
    straight: bool = False,
) -> Mesh:
    """Make ten-node tetrahedra from linear ones (e, 4) whose parameters (n, k) are mapped to mm by ``place``.

    ``place`` maps the middles of edges, too. If ``straight``, mid-edge nodes lie half-way between their corners.
    """
    ends = np.sort(tetrahedra[:, TET_EDGES].reshape(-1, 2), axis=1)
    edges, edge_of = np.unique(ends, axis=0, return_inverse=True)
    corners = place(parameters)
    middles = corners[edges].mean(axis=1) if straight else place(parameters[edges].mean(axis=1))
    ten = np.hstack([tetrahedra, len(corners) + edge_of.reshape(-1, 6)]).astype(np.int32)
    _, tetrahedron, local = boundary_triangles(tetrahedra)
    faces = np.take_along_axis(ten[tetrahedron], QUADRATIC_FACES[local], axis=1)
    return Mesh(np.vstack([corners, middles]), ten, len(corners), faces)


def box(counts=(3, 2, 3), size=(6.0, 4.0, 6.0)) -> Mesh:
    """Mesh a box by Kuhn's six tetrahedra per cell. It is centred in x and z, from the top y = 0 to y = size[1]."""
    points, tetrahedra = sizing_grid(np.zeros(3), np.array(counts, dtype=float), 1.0)
    size = np.array(size, dtype=float)
    return quadratic(points / counts * size - [size[0] / 2.0, 0.0, size[2] / 2.0], tetrahedra)


def on_plane(nodes: np.ndarray, axis: int, at: float) -> np.ndarray:
    """Mark the nodes (n,) whose coordinate ``axis`` is ``at`` mm."""
    return np.abs(nodes[:, axis] - at) < ON


def faces_on(faces: np.ndarray, on: np.ndarray) -> np.ndarray:
    """Return the faces whose nodes are all marked by ``on`` (n,) bool."""
    return faces[on[faces].all(axis=1)]


def faces_on_sphere(mesh: Mesh, radius: float) -> np.ndarray:
    """Return the boundary faces whose corners lie on a sphere about the origin."""
    corners = np.linalg.norm(mesh.nodes[mesh.faces[:, :3]], axis=2)
    return mesh.faces[(np.abs(corners - radius) < ON).all(axis=1)]


def top(nodes: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the faces in the plane y = 0."""
    return faces_on(faces, on_plane(nodes, 1, 0.0))


def perturbed(mesh: Mesh, shift: float, bend: float, inside_only: bool = False) -> Mesh:
    """Move corners at random by up to ``shift`` mm along each axis, and bend edges by up to ``bend`` mm.

    The random numbers are always the same. ``inside_only`` keeps the boundary.
    """
    random = np.random.default_rng(0)
    movable = np.ones((len(mesh.nodes), 1))
    if inside_only:
        movable[mesh.faces] = 0.0
    move = movable * random.uniform(-shift, shift, mesh.nodes.shape)
    move[mesh.tetrahedra[:, 4:].ravel()] = move[mesh.tetrahedra[:, TET_EDGES].reshape(-1, 2)].mean(axis=1)
    move[mesh.n_corners :] += (movable * random.uniform(-bend, bend, mesh.nodes.shape))[mesh.n_corners :]
    return mesh._replace(nodes=mesh.nodes + move)


def sphere_shell(around: int, through: int, radii: tuple[float, float], straight: bool = False) -> Mesh:
    """Mesh the octant x, y, z >= 0 of a thick-walled sphere, with curved edges unless ``straight``.

    around : edges along a quarter of a great circle
    through : layers of elements
    radii : inner and outer, mm
    """
    triangle = [(i, j) for i in range(around + 1) for j in range(around + 1 - i)]
    number = {pair: n for n, pair in enumerate(triangle)}
    upright = [((i, j), (i + 1, j), (i, j + 1)) for i, j in triangle if i + j < around]
    inverted = [((i + 1, j), (i + 1, j + 1), (i, j + 1)) for i, j in triangle if i + j < around - 1]
    cells = np.array([[number[pair] for pair in three] for three in upright + inverted])
    flat = np.array([(around - i - j, i, j) for i, j in triangle]) / around
    layers = np.linspace(*radii, through + 1)
    parameters = np.vstack([np.column_stack([flat, np.full(len(flat), radius)]) for radius in layers])
    prisms = np.vstack([np.hstack([cells, cells + len(flat)]) + k * len(flat) for k in range(through)])

    def place(parameters):
        directions = parameters[:, :3] / np.linalg.norm(parameters[:, :3], axis=1, keepdims=True)
        return parameters[:, 3:] * directions

    return quadratic(parameters, split_prisms(prisms), place, straight)


def split_prisms(prisms: np.ndarray) -> np.ndarray:
    """Split each prism (n, 6) into three tetrahedra (3 n, 4).

    A prism is a triangle, counter-clockwise from above, and the triangle above it. A side's diagonal starts at the
    smaller of its two lower vertices, so that neighbours agree (Dompierre et al., "How to subdivide pyramids, prisms
    and hexahedra into tetrahedra", 8th Int. Meshing Roundtable, 1999).
    """
    order = np.argsort(prisms[:, :3], axis=1)
    a, b, c = np.take_along_axis(prisms[:, :3], order, axis=1).T
    d, e, f = np.take_along_axis(prisms[:, 3:], order, axis=1).T
    tetrahedra = np.stack([[a, b, c, f], [a, b, f, e], [a, e, f, d]]).transpose(0, 2, 1)
    odd = np.linalg.det(np.eye(3)[order]) < 0.0
    tetrahedra[:, odd] = tetrahedra[:, odd][..., [1, 0, 2, 3]]
    return tetrahedra.reshape(-1, 4)
