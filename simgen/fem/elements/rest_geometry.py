"""Rest geometry of a mesh in the form of the operators' arrays.

Computing it takes half of the time that a scene needs, and a process makes several scenes on one mesh.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from simgen.fem.elements.element import Element, TetGeometry, tet_geometry, tet_rule


@dataclass(frozen=True)
class RestGeometry:
    """Rest geometry at the quadrature points of all elements.

    tets : the geometry map
    metric : (e, q, 3, 3) dxi/dX times its transpose, 1/mm2
    contraction : (e, q) det dxi/dX, 1/mm3
    mean_metric : (e, 3, 3) metric times volume, summed over the points, mm
    """

    tets: TetGeometry
    metric: np.ndarray
    contraction: np.ndarray
    mean_metric: np.ndarray


def rest_geometries(element: Element, nodes: np.ndarray, tetrahedra: np.ndarray) -> tuple[RestGeometry, RestGeometry]:
    """Rest geometry at an element's quadrature points and at those of its preconditioner; the last meshes' are kept.

    Arguments and errors are those of `tet_geometry`.
    """
    shapes = nodes.shape, tetrahedra.shape, tetrahedra.dtype.str
    return _kept(element, nodes.astype(np.float64).tobytes(), tetrahedra.tobytes(), *shapes)


@lru_cache(maxsize=4)
def _kept(
    element: Element, nodes: bytes, tetrahedra: bytes, shape: tuple[int, ...], tet_shape: tuple[int, ...], kind: str
) -> tuple[RestGeometry, RestGeometry]:
    at = np.frombuffer(nodes).reshape(shape), np.frombuffer(tetrahedra, kind).reshape(tet_shape)
    fewer = replace(element, quadrature_points=element.preconditioner_points)
    return tuple(_rest_geometry(tet_geometry(each, *at), each) for each in (element, fewer))


def _rest_geometry(tets: TetGeometry, element: Element) -> RestGeometry:
    metric = tets.inverse @ tets.inverse.swapaxes(2, 3)
    contraction = tet_rule(element.quadrature_points)[1] / (6.0 * tets.volumes)
    return RestGeometry(tets, metric, contraction, np.einsum("eq,eqij->eij", tets.volumes, metric))
