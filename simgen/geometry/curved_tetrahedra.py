"""Curved quadratic tetrahedra, whose boundary nodes lie on the true surface of the gel.

Each boundary face belongs to the smooth patch of the true surface that is nearest to the face's centre. A boundary node
belongs to the patches of its faces. A node of two or three patches lies on an edge or a corner of the body. It is
projected onto its patches in turn until it lies on all of them (von Neumann's alternating projections). So sharp edges
stay sharp.
"""

from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import trimesh

from simgen.geometry.interpolation import TET_EDGES, geometry_jacobian
from simgen.geometry.surface import ClosestPoint, patches_at, smooth_patches
from simgen.geometry.tetrahedra import TET_FACES, TRIANGLE_EDGES, boundary_triangles, signed_volumes

FREE, HELD, CORE = 0, 1, 2  # regions of the true surface: touchable, held (fixed), facing the rigid core
ROUNDS = 30  # alternating projections


def _determinant_points() -> np.ndarray:
    """Corners, mid-edges, face centres and 15 points inside, in barycentric coordinates."""
    corners = np.eye(4)
    middles = corners[TET_EDGES].mean(axis=1)
    centres = corners[TET_FACES].mean(axis=1)
    inner = np.concatenate([corners, middles, centres]) * 0.75 + 0.0625
    return np.concatenate([corners, middles, centres, inner, [[0.25] * 4]])


DETERMINANT_POINTS = _determinant_points()  # (29, 4): where the geometry map is checked


class LabelledSurface:
    """The true surface of a gel: closed triangles, each of the region FREE, HELD or CORE.

    What only meshing needs is computed when it is first used.
    """

    def __init__(self, surface: trimesh.Trimesh, region: np.ndarray):
        self.surface = surface
        self.region = region
        self._on_patch: dict[int, ClosestPoint] = {}

    @cached_property
    def patch(self) -> np.ndarray:
        """Label (f,) of each face's smooth patch. Patches end at creases and where regions end."""
        return smooth_patches(self.surface, self.region)

    @cached_property
    def _smooth(self) -> np.ndarray:
        """Label (f,) of each face's smooth patch. Patches end at creases only."""
        return smooth_patches(self.surface)

    @cached_property
    def closest(self) -> ClosestPoint:
        """Closest points on all faces."""
        return ClosestPoint(self.surface.vertices, self.surface.faces)

    def on_patch(self, patch: int) -> ClosestPoint:
        if patch not in self._on_patch:
            self._on_patch[patch] = ClosestPoint(self.surface.vertices, self.surface.faces[self.patch == patch])
        return self._on_patch[patch]

    def part(self, region: int) -> ClosestPoint | None:
        """Closest points on the faces of one region; None if the surface has no such face."""
        faces = self.surface.faces[self.region == region]
        return ClosestPoint(self.surface.vertices, faces) if len(faces) else None

    def held_edges(self) -> np.ndarray:
        """Edges (e, 2, 3) m along which held faces meet others."""
        held = self.region == HELD
        meeting = held[self.surface.face_adjacency]
        ends = self.surface.face_adjacency_edges[meeting[:, 0] != meeting[:, 1]]
        return self.surface.vertices[ends]

    def is_held(self, points: np.ndarray) -> np.ndarray:
        """True for points whose nearest face is held: (n, 3) m to (n,) bool."""
        return self.region[self.closest(points)[2]] == HELD

    def patches_at(self, vertices: np.ndarray, faces: np.ndarray) -> list[set[int]]:
        """Labels of the smooth patches at each vertex of a nearby boundary (f, 3): two or more on a crease."""
        nearest = self.closest(vertices[faces].mean(axis=1))[2]
        return patches_at(len(vertices), faces, self._smooth[nearest])

    def area(self, region: int) -> float:
        """Area of a region, m2."""
        return float(self.surface.area_faces[self.region == region].sum())

    def project(self, points: np.ndarray, patches: list[tuple[int, ...]], limit: float) -> np.ndarray:
        """Project points (n, 3) m onto all of their patches.

        A point that this would move by more than ``limit`` (m) is projected onto the nearest face instead.
        """
        on = np.array(points)
        members = defaultdict(list)
        for i, own in enumerate(patches):
            for patch in own:
                members[patch].append(i)
        several = np.array([len(own) > 1 for own in patches])
        for turn in range(ROUNDS):
            for patch, rows in members.items():
                rows = np.array(rows)
                rows = rows if turn == 0 else rows[several[rows]]
                if len(rows):
                    on[rows] = self.on_patch(patch)(on[rows])[0]
        far = np.linalg.norm(on - points, axis=1) > limit
        if far.any():
            on[far] = self.closest(points[far])[0]
        return on


@dataclass(frozen=True)
class CurvedMesh:
    """Ten-node tetrahedra whose boundary follows the true surface."""

    nodes: np.ndarray  # (n, 3) m, corners first
    n_corners: int
    tetrahedra: np.ndarray  # (e, 10) int32
    faces: np.ndarray  # (f, 6) int32 outward quadratic triangles of the boundary
    region: np.ndarray  # (f,) FREE, HELD or CORE
    straightened: int  # edges left straight because the curved element would be nearly inverted


def determinants(nodes: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Determinant (e, d) of the geometry map at `DETERMINANT_POINTS`, relative to the straight element's."""
    det = np.linalg.det(geometry_jacobian(nodes[tetrahedra][:, None], DETERMINANT_POINTS[None]))
    return det / (6.0 * signed_volumes(nodes, tetrahedra))[:, None]


def face_regions(vertices: np.ndarray, faces: np.ndarray, true: LabelledSurface) -> tuple[np.ndarray, np.ndarray]:
    """Region (f,) and smooth patch (f,) of the true surface nearest the centre of each boundary triangle (f, 3)."""
    nearest = true.closest(vertices[faces].mean(axis=1))[2]
    return true.region[nearest], true.patch[nearest]


def make_quadratic(
    vertices: np.ndarray, tetrahedra: np.ndarray, true: LabelledSurface, limit: float, least_det: float = 0.2
) -> CurvedMesh:
    """Make ten-node tetrahedra with their boundary nodes on the true surface.

    limit: largest move of a node along its patches, m.
    least_det: an element whose relative determinant falls below this keeps straight edges.
    """
    faces, _, _ = boundary_triangles(tetrahedra)
    region, patch = face_regions(vertices, faces, true)
    vertices = _project_corners(vertices, tetrahedra, faces, patch, true, limit)

    ends = np.sort(tetrahedra[:, TET_EDGES].reshape(-1, 2), axis=1)
    edges, edge_of = np.unique(ends, axis=0, return_inverse=True)
    edge_of = edge_of.reshape(-1, 6)
    straight = vertices[edges].mean(axis=1)
    face_edges = _edge_numbers(edges, np.sort(faces[:, TRIANGLE_EDGES].reshape(-1, 2), axis=1)).reshape(-1, 3)
    on_edge = defaultdict(set)
    for number, label in zip(face_edges.ravel(), np.repeat(patch, 3), strict=True):
        on_edge[number].add(int(label))
    outer = np.array(sorted(on_edge))
    curved = straight.copy()
    curved[outer] = true.project(straight[outer], [tuple(on_edge[e]) for e in outer], limit)

    ten = np.concatenate([tetrahedra, len(vertices) + edge_of], axis=1).astype(np.int32)
    is_outer = np.zeros(len(edges), dtype=bool)
    is_outer[outer] = True
    straightened = 0
    while True:
        nodes = np.concatenate([vertices, curved])
        bad = determinants(nodes, ten).min(axis=1) < least_det
        back = np.unique(edge_of[bad])
        back = back[is_outer[back]]
        if not len(back):
            break
        curved[back] = straight[back]
        is_outer[back] = False
        straightened += len(back)
    return CurvedMesh(
        nodes=nodes,
        n_corners=len(vertices),
        tetrahedra=ten,
        faces=np.concatenate([faces, len(vertices) + face_edges], axis=1).astype(np.int32),
        region=region,
        straightened=straightened,
    )


def _edge_numbers(edges: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Row of each wanted pair in the sorted unique ``edges``."""
    size = np.int64(edges.max()) + 1  # of int32 numbers, whose products would overflow
    return np.searchsorted(edges[:, 0] * size + edges[:, 1], wanted[:, 0] * size + wanted[:, 1])


def _project_corners(vertices, tetrahedra, faces, patch, true, limit) -> np.ndarray:
    """Move boundary corners onto the true surface, as far as each tetrahedron keeps half of its volume."""
    on_corner, outer = patches_at(len(vertices), faces, patch), np.unique(faces)
    move = np.zeros_like(vertices)
    move[outer] = true.project(vertices[outer], [tuple(on_corner[c]) for c in outer], limit) - vertices[outer]
    before = signed_volumes(vertices, tetrahedra)
    for _ in range(20):
        squashed = signed_volumes(vertices + move, tetrahedra) < 0.5 * before
        if not squashed.any():
            break
        move[np.unique(tetrahedra[squashed])] *= 0.5
    return vertices + move
