"""Tetrahedral elements: shape functions, quadrature and the geometry map.

``P2-P1`` is the Taylor-Hood element: quadratic displacement on (possibly curved) ten-node tetrahedra and continuous
linear pressure. ``P1`` is the linear tetrahedron with constant strain and no pressure, for comparison only. Node order
is VTK's: corners 0-3, then the middles of the edges 01, 12, 20, 03, 13, 23.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np

from simgen.geometry.interpolation import TET_EDGES
from simgen.geometry.tetrahedra import TRIANGLE_EDGES


def barycentric_p2(barycentric: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Quadratic shape functions at barycentric points: (q, 3 or 4) -> (q, 6 or 10)."""
    corner = barycentric * (2.0 * barycentric - 1.0)
    middle = 4.0 * barycentric[:, edges[:, 0]] * barycentric[:, edges[:, 1]]
    return np.concatenate([corner, middle], axis=1)


def barycentric_p2_gradient(barycentric: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Derivatives of the quadratic shape functions by each barycentric coordinate: (q, nodes, 3 or 4)."""
    q, n = barycentric.shape
    gradient = np.zeros((q, n + len(edges), n))
    for i in range(n):
        gradient[:, i, i] = 4.0 * barycentric[:, i] - 1.0
    for e, (i, j) in enumerate(edges):
        gradient[:, n + e, i] = 4.0 * barycentric[:, j]
        gradient[:, n + e, j] = 4.0 * barycentric[:, i]
    return gradient


def _orbit(values: list[float]) -> np.ndarray:
    """All distinct permutations of one barycentric point."""
    return np.array(sorted(set(permutations(values))))


def tet_rule(points: int) -> tuple[np.ndarray, np.ndarray]:
    """Symmetric quadrature with positive weights on the tetrahedron: barycentric points (q, 4), weights (q,) of sum 1.

    1, 4, 8 and 14 points integrate polynomials of degree 1, 2, 3 and 5 exactly (Felippa, "A compendium of FEM
    integration formulas for symbolic work", Eng. Comput. 21, 2004).
    """
    if points == 1:
        orbits = [([0.25] * 4, 1.0)]
    elif points == 4:
        a = (5.0 - np.sqrt(5.0)) / 20.0
        orbits = [([a, a, a, 1.0 - 3.0 * a], 0.25)]
    elif points == 8:
        a = (55.0 - 3.0 * np.sqrt(17.0) + np.sqrt(1022.0 - 134.0 * np.sqrt(17.0))) / 196.0
        b = (55.0 - 3.0 * np.sqrt(17.0) - np.sqrt(1022.0 - 134.0 * np.sqrt(17.0))) / 196.0
        w = 1.0 / 8.0 + np.sqrt((1715161837.0 - 406006699.0 * np.sqrt(17.0)) / 23101.0) / 3120.0
        orbits = [([a, a, a, 1.0 - 3.0 * a], w), ([b, b, b, 1.0 - 3.0 * b], 0.25 - w)]
    elif points == 14:
        a, b, c = 0.092735250310891226402, 0.310885919263300609797, 0.045503704125649649492
        wa, wb = 0.073493043116361949544, 0.112687925718015850799
        orbits = [
            ([a, a, a, 1.0 - 3.0 * a], wa),
            ([b, b, b, 1.0 - 3.0 * b], wb),
            ([c, c, 0.5 - c, 0.5 - c], (1.0 - 4.0 * (wa + wb)) / 6.0),
        ]
    else:
        raise ValueError(f"no tetrahedron rule with {points} points; there are rules with 1, 4, 8 and 14")
    parts = [_orbit([float(v) for v in point]) for point, _ in orbits]
    weights = np.concatenate([np.full(len(p), w) for p, (_, w) in zip(parts, orbits, strict=True)])
    return np.concatenate(parts), weights


def triangle_rule(points: int) -> tuple[np.ndarray, np.ndarray]:
    """Symmetric quadrature with positive weights on the triangle: barycentric points (q, 3), weights (q,) of sum 1.

    6 and 12 points integrate polynomials of degree 4 and 6 exactly (Dunavant, Int. J. Numer. Meth. Engng 21, 1985).
    """
    if points == 6:
        orbits = [([0.445948490915964886, 0.445948490915964886], 0.223381589678011466),
                  ([0.091576213509770743, 0.091576213509770743], 0.109951743655321868)]  # fmt: skip
    elif points == 12:
        orbits = [([0.249286745170910, 0.249286745170910], 0.116786275726379),
                  ([0.063089014491502, 0.063089014491502], 0.050844906370207),
                  ([0.310352451033785, 0.053145049844816], 0.082851075618374)]  # fmt: skip
    else:
        raise ValueError(f"no triangle rule with {points} points; there are rules with 6 and 12")
    parts = [_orbit([*point, 1.0 - sum(point)]) for point, _ in orbits]
    weights = np.concatenate([np.full(len(p), w) for p, (_, w) in zip(parts, orbits, strict=True)])
    return np.concatenate(parts), weights / weights.sum()


@dataclass(frozen=True)
class Element:
    """Element type: nodes, pressure nodes and quadrature points of a tetrahedron, and quadrature points of a face.

    Contact begins and ends within faces, so its force depends on the number of face points: for a sphere of R = 3.5 mm,
    0.5 mm deep, edges of 1.1 mm, it is 2.4 % too large with 6 points and 1.4 % with 16.

    The preconditioner uses half the points of a tetrahedron: Krylov iterations stay the same within a percent. With so
    few points, Newton's method itself would take as many iterations in most presses. But where elements nearly invert,
    it takes a quarter more, and 29 presses of jobs/paired.yaml fail on the DIGIT instead of 2 to 4.
    """

    name: str
    nodes: int
    pressures: int
    quadrature_points: int
    preconditioner_points: int
    face_points: int


P2P1 = Element("P2-P1", nodes=10, pressures=4, quadrature_points=8, preconditioner_points=4, face_points=12)
P1 = Element("P1", nodes=4, pressures=0, quadrature_points=1, preconditioner_points=1, face_points=6)
ELEMENTS = {element.name: element for element in (P2P1, P1)}


@dataclass(frozen=True)
class TetGeometry:
    """Rest geometry of all elements at their quadrature points.

    local_gradients : (q, nodes, 3) derivatives of the shape functions by an element's coordinates xi
    inverse : (e, q, 3, 3) dxi/dX, 1/mm
    volumes : (e, q) weight times det of the geometry map, mm3
    corner_shapes : (q, 4) linear shape functions
    corner_jacobians : (e, 4, 3, 3) dX/dxi at the corners, mm
    """

    local_gradients: np.ndarray
    inverse: np.ndarray
    volumes: np.ndarray
    corner_shapes: np.ndarray
    corner_jacobians: np.ndarray

    @property
    def gradients(self) -> np.ndarray:
        """(e, q, nodes, 3) derivatives of the shape functions by rest position, 1/mm."""
        return np.einsum("qaj,eqji->eqai", self.local_gradients, self.inverse)


def tet_geometry(element: Element, nodes: np.ndarray, tetrahedra: np.ndarray) -> TetGeometry:
    """Evaluate the geometry map of straight or curved elements; nodes (n, 3) mm, tetrahedra (e, 10 or 4).

    Raises ValueError if the map is inverted at a quadrature point.
    """
    points, weights = tet_rule(element.quadrature_points)
    by_local, at_corners = (_local_gradients(element, at) for at in (points, np.eye(4)))
    position = nodes[tetrahedra[:, : element.nodes]]
    jacobian, corner_jacobians = (_jacobians(position, gradients) for gradients in (by_local, at_corners))
    inverse, determinant = _inverses(jacobian)
    if determinant.min() <= 0.0:
        worst = int(determinant.min(axis=1).argmin())
        raise ValueError(f"tetrahedron {worst} is inverted: its geometry map has determinant {determinant.min():.3g}")
    return TetGeometry(by_local, inverse, determinant * weights / 6.0, points, corner_jacobians)


def _jacobians(position: np.ndarray, gradients: np.ndarray) -> np.ndarray:
    """Derivatives (e, q, 3, 3) of positions (e, nodes, 3), by gradients (q, nodes, 3) of the shape functions.

    One product of two matrices is five times as fast as `numpy.einsum`.
    """
    e, nodes, _ = position.shape
    product = position.swapaxes(1, 2).reshape(-1, nodes) @ gradients.swapaxes(0, 1).reshape(nodes, -1)
    return np.ascontiguousarray(product.reshape(e, 3, -1, 3).swapaxes(1, 2))


def _inverses(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inverses (..., 3, 3) and determinants (...); the inverse of a singular matrix is not finite.

    Cofactors take a third of the time of `numpy.linalg`.
    """
    a, b, c = np.moveaxis(matrices, -1, 0)
    cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-2)
    determinant = np.vecdot(a, cofactors[..., 0, :])
    with np.errstate(divide="ignore", invalid="ignore"):
        return cofactors / determinant[..., None, None], determinant


def _local_gradients(element: Element, barycentric: np.ndarray) -> np.ndarray:
    """Derivatives of the shape functions by the element's coordinates: (q, nodes, 3) at points (q, 4)."""
    if element.nodes == 10:
        by_barycentric = barycentric_p2_gradient(barycentric, TET_EDGES)
    else:
        by_barycentric = np.broadcast_to(np.eye(4), (len(barycentric), 4, 4))
    return by_barycentric[:, :, 1:] - by_barycentric[:, :, :1]


@dataclass(frozen=True)
class FaceGeometry:
    """Rest geometry of surface triangles at their quadrature points.

    shapes : (q, nodes) shape functions of the displacement
    multiplier_shapes : (q, 3) linear shape functions of the contact multipliers
    areas : (f, q) weight times area of the (curved) face, mm2
    """

    shapes: np.ndarray
    multiplier_shapes: np.ndarray
    areas: np.ndarray


def face_shapes(element: Element, q: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shape functions (q, nodes) at a face's q points, derivatives by its coordinates (q, nodes, 2), weights (q,).

    The weights sum to 1/2, the area of the reference triangle.
    """
    points, weights = triangle_rule(q)
    if element.nodes == 10:
        shapes, by_barycentric = barycentric_p2(points, TRIANGLE_EDGES), barycentric_p2_gradient(points, TRIANGLE_EDGES)
    else:
        shapes, by_barycentric = points, np.broadcast_to(np.eye(3), (len(points), 3, 3))
    return shapes, by_barycentric[:, :, 1:] - by_barycentric[:, :, :1], 0.5 * weights


def face_geometry(element: Element, nodes: np.ndarray, faces: np.ndarray) -> FaceGeometry:
    """Quadrature of P2 (six nodes) or P1 (three nodes) faces; nodes (n, 3) mm, faces (f, 6)."""
    shapes, by_local, weights = face_shapes(element, element.face_points)
    tangents = np.einsum("fai,qaj->fqij", nodes[faces[:, : shapes.shape[1]]], by_local)
    normals = np.cross(tangents[..., 0], tangents[..., 1])
    return FaceGeometry(shapes, triangle_rule(element.face_points)[0], weights * np.linalg.norm(normals, axis=-1))
