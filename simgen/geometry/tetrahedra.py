"""Tetrahedral meshes of a gel: the quadratic one for the solver, the linear output mesh, and the mesher.

The mesher is pytetwild (fTetWild: Hu et al., "Fast tetrahedral meshing in the wild", ACM TOG 39, 2020).
`curved_tetrahedra` then moves boundary nodes onto the true surface, and `mesh_quality` checks the result.
"""

import contextlib
import tempfile
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import trimesh

from simgen.errors import InputError

TET_FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])  # outward if the volume is positive
TRIANGLE_EDGES = np.array([[0, 1], [1, 2], [2, 0]])


@dataclass(frozen=True)
class SimulationMesh:
    """Curved ten-node tetrahedra of a gel, in VTK's node order: corners 0-3, edges 01 12 20 03 13 23.

    Quadratic triangles have corners 0-2 and edges 01 12 20. They face outwards.
    """

    nodes: np.ndarray  # (n, 3) float64, m; corner nodes first
    n_corners: int  # nodes[:n_corners] are corners of tetrahedra
    tetrahedra: np.ndarray  # (e, 10) int32, positive volume
    held: np.ndarray  # (n,) bool: fixed nodes; (n, 3) fixes single components (symmetry planes)
    touchable: np.ndarray  # (f, 6) int32: triangles that an indenter may touch
    facing_core: np.ndarray  # (g, 6) int32: triangles that may meet the rigid core
    hash: str  # of the arrays and of the geometry and settings


@dataclass(frozen=True)
class OutputMesh:
    """Linear tetrahedra whose displacements the dataset stores."""

    vertices: np.ndarray  # (v, 3) float64, m
    tetrahedra: np.ndarray  # (t, 4) int32
    surface_triangles: np.ndarray  # (s, 3) int32, outward
    held: np.ndarray  # (v,) bool
    touchable: np.ndarray  # (v,) bool
    hash: str

    @cached_property
    def surface_vertices(self) -> np.ndarray:
        """(s,) indices of the vertices on the surface, in rising order."""
        found = np.unique(self.surface_triangles)
        found.setflags(write=False)  # all callers share it
        return found


def signed_volumes(vertices: np.ndarray, tetrahedra: np.ndarray) -> np.ndarray:
    """Volumes (e,) of straight tetrahedra given by their corners; negative where inverted."""
    a, b, c, d = (vertices[tetrahedra[:, i]] for i in range(4))
    return np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)) / 6.0


def boundary_triangles(tetrahedra: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Faces of only one tetrahedron: outward corners (f, 3), tetrahedron (f,), local number of the face (f,)."""
    faces = tetrahedra[:, TET_FACES].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    single = np.sort(first[count == 1])
    return faces[single], single // 4, single % 4


def boundary_edges(tetrahedra: np.ndarray) -> np.ndarray:
    """Edges (e, 2) of the boundary, each once."""
    ends = boundary_triangles(tetrahedra)[0][:, TRIANGLE_EDGES].reshape(-1, 2)
    return np.unique(np.sort(ends, axis=1), axis=0)


def sizing_grid(low: np.ndarray, high: np.ndarray, cell: float) -> tuple[np.ndarray, np.ndarray]:
    """Divide a box into cubes of six tetrahedra each (Kuhn): points (p, 3), tetrahedra (t, 4)."""
    counts = np.maximum(np.ceil((high - low) / cell).astype(int), 1) + 1
    axes = [np.linspace(low[i], high[i], counts[i]) for i in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    index = np.arange(len(points)).reshape(counts)
    start = index[:-1, :-1, :-1].ravel()
    step = np.array([counts[1] * counts[2], counts[2], 1])
    paths = [(0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)]
    tetrahedra = []
    for path in paths:
        corners = np.cumsum([0, *step[list(path)]])
        if path in paths[3:]:  # an odd permutation inverts the tetrahedron
            corners[[1, 2]] = corners[[2, 1]]
        tetrahedra.append(start[:, None] + corners)
    return points, np.concatenate(tetrahedra).astype(np.int32)


def tetrahedralize(
    surface: trimesh.Trimesh, edge_length, envelope: float, cell: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Fill a closed surface with tetrahedra of positive volume: vertices (v, 3), tetrahedra (t, 4) int32.

    edge_length: m, or a function of points (p, 3) to lengths (p,), m, which is sampled on a grid of spacing ``cell``.
    envelope: largest distance of the mesh's boundary from the surface, m.

    The result differs from run to run, because fTetWild is not deterministic. Raises InputError if the mesh is empty.
    """
    import pytetwild  # imports VTK, which takes 0.3 s and 60 MB that a press does not need

    diagonal = float(np.linalg.norm(np.ptp(surface.vertices, axis=0)))
    sizing = {}
    if callable(edge_length):
        points, grid = sizing_grid(surface.vertices.min(axis=0) - cell, surface.vertices.max(axis=0) + cell, cell)
        values = edge_length(points)
        sizing = {"bg_vertices": points, "bg_tets": grid, "bg_values": values}
        edge_length = float(values.max())
    # fTetWild writes scratch files into the current folder.
    with tempfile.TemporaryDirectory() as scratch, contextlib.chdir(scratch):
        vertices, tetrahedra = pytetwild.tetrahedralize(
            np.asarray(surface.vertices, dtype=float),
            np.asarray(surface.faces, dtype=np.int32),
            edge_length_fac=edge_length / diagonal,
            epsilon=envelope / diagonal,
            optimize=True,
            vtk_ordering=True,  # the default order gives negative volumes
            num_threads=1,
            **sizing,
        )
    if not len(tetrahedra):
        raise InputError(f"no tetrahedron inside the surface at an edge length of {edge_length * 1e3:.3g} mm")
    used, tetrahedra = np.unique(tetrahedra, return_inverse=True)
    return vertices[used], tetrahedra.reshape(-1, 4).astype(np.int32)
