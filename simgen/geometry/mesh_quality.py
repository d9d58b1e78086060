"""Measures of a mesh's quality, and the gates that a mesh must pass before it is used.

A straight tetrahedron is judged by its mean ratio, eta = 12 (3 V)^(2/3) / sum of squared edges (Liu and Joe, BIT 34,
1994): 1 if regular, 0 if flat. It is 3 / (AMIPS energy). fTetWild works until no element has an energy above 10, which
is eta = 0.3. The gate stands at 0.15. That leaves room for moving boundary nodes onto the true surface. It is far from
slivers, which ruin the conditioning: the largest eigenvalue of an element's stiffness grows as 1 / eta^(3/2).
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from simgen.errors import InputError
from simgen.geometry.curved_tetrahedra import HELD, CurvedMesh, LabelledSurface, determinants
from simgen.geometry.interpolation import TET_EDGES, geometry_jacobian
from simgen.geometry.surface import enclosed_volume
from simgen.geometry.tetrahedra import TET_FACES, TRIANGLE_EDGES, boundary_triangles, signed_volumes

LEAST_MEAN_RATIO = 0.15
LEAST_DETERMINANT = 0.2  # of the geometry map, relative to the straight element's
VOLUME_TOLERANCE = 0.02  # of the true volume
HELD_AREA_TOLERANCE = 0.2  # of the true held area: a held patch of a user's own tetrahedra may have a jagged rim


@dataclass(frozen=True)
class MeshQuality:
    """The numbers that the gates check. Volumes in m3."""

    nodes: int
    tetrahedra: int
    least_mean_ratio: float
    least_determinant: float
    volume: float
    volume_error: float  # relative to the true surface
    components: int
    boundary_shells: int
    open_edges: int
    held_nodes: int
    held_area_error: float  # relative to the true held area

    def __str__(self) -> str:
        return (
            f"{self.tetrahedra} tetrahedra, mean ratio >= {self.least_mean_ratio:.3f}, "
            f"det >= {self.least_determinant:.3f}, "
            f"volume {self.volume * 1e9:.1f} mm3 ({self.volume_error:+.2%}), "
            f"held area {self.held_area_error:+.1%}"
        )


def mean_ratio(vertices: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Mean ratio (e,) of straight tetrahedra; negative where inverted."""
    ends = vertices[tetrahedra[:, TET_EDGES]]
    squares = ((ends[:, :, 1] - ends[:, :, 0]) ** 2).sum(axis=(1, 2))
    volume = signed_volumes(vertices, tetrahedra)
    return np.sign(volume) * 12.0 * np.abs(3.0 * volume) ** (2.0 / 3.0) / squares


def curved_volume(nodes: np.ndarray, tetrahedra: np.ndarray) -> float:
    """Volume, m3, of tetrahedra (e, 10) with nodes (n, 3) m. The five-point rule is exact for their determinant."""
    points = np.concatenate([np.full((1, 4), 0.25), np.full((4, 4), 1 / 6) + np.eye(4) / 3])
    weights = np.array([-4 / 5, *[9 / 20] * 4]) / 6.0  # Zienkiewicz, The Finite Element Method
    return float((np.linalg.det(geometry_jacobian(nodes[tetrahedra][:, None], points)) @ weights).sum())


def curved_area(nodes: np.ndarray, faces: np.ndarray) -> float:
    """Area, m2, of triangles (f, 6) by the three-point rule; exact for flat triangles, even with curved edges."""
    area = 0.0
    for a, b, c in np.full((3, 3), 1 / 6) + np.eye(3) / 2:
        # Derivatives of the shape functions (corners, edges 01 12 20) by b and c.
        by_b = np.array([1 - 4 * a, 4 * b - 1, 0, 4 * (a - b), 4 * c, -4 * c])
        by_c = np.array([1 - 4 * a, 0, 4 * c - 1, -4 * b, 4 * b, 4 * (a - c)])
        tangents = np.einsum("fni,kn->fki", nodes[faces], np.stack([by_b, by_c]))
        area += np.linalg.norm(np.cross(tangents[:, 0], tangents[:, 1]), axis=1).sum() / 6.0
    return float(area)


def components(tetrahedra: np.ndarray) -> int:
    """Number of bodies: tetrahedra that share a face are of the same body."""
    faces = np.sort(tetrahedra[:, TET_FACES].reshape(-1, 3), axis=1)
    _, face = np.unique(faces, axis=0, return_inverse=True)
    return _components(face.ravel(), np.repeat(np.arange(len(tetrahedra)), 4))


def boundary_topology(faces: np.ndarray) -> tuple[int, int]:
    """Number of closed shells of triangles, and number of edges that do not join exactly two triangles."""
    edges = np.sort(faces[:, TRIANGLE_EDGES].reshape(-1, 2), axis=1)
    _, edge, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    return _components(edge.ravel(), np.repeat(np.arange(len(faces)), 3)), int((count != 2).sum())


def _components(shared: np.ndarray, owner: np.ndarray) -> int:
    order = np.argsort(shared, kind="stable")
    joined = np.flatnonzero(shared[order][1:] == shared[order][:-1])
    a, b = owner[order][joined], owner[order][joined + 1]
    n = owner.max() + 1
    return connected_components(coo_matrix((np.ones(len(a)), (a, b)), shape=(n, n)), directed=False)[0]


def measure(mesh: CurvedMesh, true: LabelledSurface) -> MeshQuality:
    """Measure a curved mesh against its true surface."""
    corners = mesh.tetrahedra[:, :4]
    least_det = determinants(mesh.nodes, mesh.tetrahedra).min()
    volume = curved_volume(mesh.nodes, mesh.tetrahedra)
    true_volume = enclosed_volume(true.surface.vertices, true.surface.faces)
    held_area = curved_area(mesh.nodes, mesh.faces[mesh.region == HELD])
    shells, open_edges = boundary_topology(boundary_triangles(corners)[0])
    return MeshQuality(
        nodes=len(mesh.nodes),
        tetrahedra=len(corners),
        least_mean_ratio=float(mean_ratio(mesh.nodes, corners).min()),
        least_determinant=float(least_det),
        volume=volume,
        volume_error=volume / true_volume - 1.0,
        components=components(corners),
        boundary_shells=shells,
        open_edges=open_edges,
        held_nodes=len(np.unique(mesh.faces[mesh.region == HELD])),
        held_area_error=held_area / max(true.area(HELD), 1e-30) - 1.0,
    )


def check(quality: MeshQuality, shells: int, name: str) -> None:
    """Raises InputError with every gate that the mesh fails. ``shells``: closed shells of the true surface."""
    gates = [
        (quality.least_mean_ratio >= LEAST_MEAN_RATIO,
         f"a tetrahedron of mean ratio {quality.least_mean_ratio:.3g}, least allowed {LEAST_MEAN_RATIO}"),
        (quality.least_determinant >= LEAST_DETERMINANT,
         f"a geometry determinant of {quality.least_determinant:.3g}, least allowed {LEAST_DETERMINANT}"),
        (abs(quality.volume_error) <= VOLUME_TOLERANCE,
         f"volume off by {quality.volume_error:+.2%}, allowed {VOLUME_TOLERANCE:.0%}"),
        (quality.components == 1, f"{quality.components} separate bodies, allowed 1"),
        (quality.boundary_shells == shells, f"{quality.boundary_shells} closed shells, allowed {shells}"),
        (quality.open_edges == 0, f"{quality.open_edges} open boundary edges, allowed 0"),
        (quality.held_nodes > 0, "no held node, at least 3 are needed"),
        (abs(quality.held_area_error) <= HELD_AREA_TOLERANCE,
         f"held area off by {quality.held_area_error:+.1%}, allowed {HELD_AREA_TOLERANCE:.0%}"),
    ]  # fmt: skip
    failed = [text for passed, text in gates if not passed]
    if failed:
        raise InputError(f"{name}: the mesh fails its gates: {'; '.join(failed)}")
