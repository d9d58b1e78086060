"""Structured meshes of round layers: rings of triangles around the axis y, extruded to ten-node tetrahedra.

Edges are short under the contact and grow outwards and towards the bottom. Mid-edge nodes lie at the mean radius of
their ends, so that rings and side are round. Lengths are in mm.
"""

import math
from itertools import pairwise

import numpy as np
import trimesh

from simgen.geometry.tetrahedra import OutputMesh, SimulationMesh
from simgen.sensors.sensor import Sensor
from simgen.units import MM
from simgen.verification.validate.meshes import Mesh, on_plane, quadratic, split_prisms


def graded(end: float, edge: float, until: float, growth: float) -> np.ndarray:
    """Place points from 0 to ``end``, spaced by ``edge`` up to ``until`` and by ``edge + growth (r - until)`` beyond.

    The points divide the integral of 1 / spacing into equal parts. So the spacing changes smoothly and fits ``end``.
    """
    r = np.linspace(0.0, end, 10001)
    density = 1.0 / (edge + growth * np.maximum(r - until, 0.0))
    parts = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(r))])
    return np.interp(np.linspace(0.0, parts[-1], max(round(parts[-1]), 1) + 1), parts, r)


def rings(radii: np.ndarray, segments: int, quarters: int) -> tuple[np.ndarray, np.ndarray]:
    """Triangulate the sector from +x over ``quarters`` right angles towards +z: points (p, 2), triangles (t, 3).

    Triangles are counter-clockwise seen from +y. radii: those of the rings, 0 first. Ring i has i + 1 segments in each
    quarter, at most ``segments``. Four quarters make a closed disc.
    """
    counts = [quarters * min(i + 1, segments) for i in range(1, len(radii))]
    angles = [np.zeros(1), *(np.linspace(0.0, 0.5 * math.pi * quarters, count + 1) for count in counts)]
    points = [r * np.column_stack([np.cos(a), np.sin(a)]) for r, a in zip(radii, angles, strict=True)]
    first = np.cumsum([0, *map(len, angles)])
    triangles = []
    for i in range(len(radii) - 1):
        triangles += _between(angles[i] + 1e-9 * (-1) ** i, angles[i + 1], first[i], first[i + 1])
    points, triangles = np.concatenate(points), np.array(triangles)
    if quarters < 4:
        return points, triangles
    last = first[2:] - 1  # last point of each ring, which lies on its first point
    merged = np.arange(len(points))
    merged[last] = first[1:-1]
    kept = np.setdiff1d(merged, last)
    return points[kept], np.searchsorted(kept, merged)[triangles]


def _between(inner: np.ndarray, outer: np.ndarray, first_inner: int, first_outer: int) -> list[tuple[int, int, int]]:
    """Triangulate between two rings, given by their angles: the edge whose middle comes first makes the next triangle.

    Equal rings need a tiny difference of angle, which decides the direction of their diagonals.
    """
    middles = [(0.5 * (a + b), 0, i) for i, (a, b) in enumerate(pairwise(inner))]
    middles += [(0.5 * (a + b), 1, i) for i, (a, b) in enumerate(pairwise(outer))]
    at = [first_inner, first_outer]
    triangles = []
    for _, ring, _ in sorted(middles):
        triangles.append((at[0], at[ring] + 1, at[1]))
        at[ring] += 1
    return triangles


def round_layer(radii: np.ndarray, levels: np.ndarray, segments: int, quarters: int = 1) -> Mesh:
    """Mesh a sector of a cylinder whose top at y = levels[0] faces -y. radii and levels in mm; see `rings`."""
    flat, triangles = rings(radii, segments, quarters)
    corners = [np.column_stack([flat[:, 0], np.full(len(flat), y), flat[:, 1]]) for y in levels]
    prisms = [np.hstack([triangles, triangles + len(flat)]) + i * len(flat) for i in range(len(levels) - 1)]
    corners = np.concatenate(corners)
    radius = np.hypot(corners[:, 0], corners[:, 2])
    mesh = quadratic(np.column_stack([corners, radius]), split_prisms(np.concatenate(prisms)), _at_radius)
    mesh.nodes[np.abs(mesh.nodes) < 1e-12] = 0.0  # exactly on the planes of symmetry
    return mesh


def _at_radius(parameters: np.ndarray) -> np.ndarray:
    """Points (n, 3) at y, in the direction (x, z) at the radius; parameters (n, 4) are x, y, z, radius."""
    points = parameters[:, :3].copy()
    length = np.hypot(points[:, 0], points[:, 2])
    points[:, [0, 2]] *= (parameters[:, 3] / np.where(length > 0.0, length, 1.0))[:, None]
    return points


def fixed_symmetric(mesh: Mesh, axes: tuple[int, ...], bottom: float) -> np.ndarray:
    """Mark (n, 3) fixed components: all at y = ``bottom``, the normal one on the planes of symmetry of ``axes``."""
    fixed = np.zeros(mesh.nodes.shape, dtype=bool)
    for axis in axes:
        fixed[on_plane(mesh.nodes, axis, 0.0), axis] = True
    fixed[on_plane(mesh.nodes, 1, bottom)] = True
    return fixed


def points_on_top(azimuths: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Place points (azimuths x radii, 3) in the plane y = 0."""
    x, z = np.outer(np.cos(azimuths), radii), np.outer(np.sin(azimuths), radii)
    return np.stack([x, np.zeros_like(x), z], axis=-1).reshape(-1, 3)


def make_sensor(mesh: Mesh, fixed: np.ndarray, touchable: np.ndarray, points: np.ndarray) -> Sensor:
    """Make a sensor of a structured mesh, without materials; its output vertices are the points (p, 3) mm.

    fixed : (n,) or (n, 3) bool, nodes or their components; touchable : faces (f, 6)
    """
    no_faces = np.zeros((0, 6), dtype=np.int32)
    body = SimulationMesh(mesh.nodes * MM, mesh.n_corners, mesh.tetrahedra, fixed, touchable, no_faces, hash="")
    output = OutputMesh(
        vertices=points * MM,
        tetrahedra=np.zeros((0, 4), dtype=np.int32),
        surface_triangles=np.zeros((0, 3), dtype=np.int32),
        held=np.zeros(len(points), dtype=bool),
        touchable=np.ones(len(points), dtype=bool),
        hash="",
    )
    surface = trimesh.Trimesh(body.nodes, mesh.faces[:, :3], process=False)
    return Sensor(
        name="structured",
        surface=surface,
        surface_region=np.zeros(len(surface.faces), dtype=int),
        simulation_mesh=body,
        output_mesh=output,
        materials={},
        core=None,
        core_friction=0.0,
        electrodes=None,
        cameras={},
        held_regions={},
    )
