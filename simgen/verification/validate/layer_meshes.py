"""Round layers in structured, graded, ten-node tetrahedra: rings of triangles around the axis y, extruded.

Edges are fine under the contact and grow steadily outwards and towards the bottom. The mid-edge nodes lie at the mean
radius of their ends, so that rings and side are round. Lengths in mm.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import trimesh

from simgen.geometry.tetrahedra import OutputMesh, SimulationMesh
from simgen.sensors.sensor import Sensor
from simgen.units import MM
from simgen.verification.validate.meshes import Mesh, quadratic, split_prisms


def graded(end: float, edge: float, until: float, growth: float) -> np.ndarray:
    """Points from 0 to ``end``, spaced by ``edge`` as far as ``until`` and by ``edge + growth (r - until)`` beyond.

    They cut the integral of 1 / spacing into equal parts, so that the spacing changes smoothly and ends at ``end``.
    """
    r = np.linspace(0.0, end, 10001)
    density = 1.0 / (edge + growth * np.maximum(r - until, 0.0))
    parts = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(r))])
    return np.interp(np.linspace(0.0, parts[-1], max(round(parts[-1]), 1) + 1), parts, r)


def rings(radii: np.ndarray, segments: int, quarters: int) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of the sector from +x over ``quarters`` right angles towards +z: points (p, 2), triangles (t, 3).

    Counter-clockwise seen from +y. radii: of the rings, 0 first. Ring i has i + 1 segments in each quarter, at most
    ``segments``. Four right angles make a closed disc.
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
    last = first[2:] - 1  # of each ring: it lies on the ring's first point
    merged = np.arange(len(points))
    merged[last] = first[1:-1]
    kept = np.setdiff1d(merged, last)
    return points[kept], np.searchsorted(kept, merged)[triangles]


def _between(inner: np.ndarray, outer: np.ndarray, first_inner: int, first_outer: int) -> list[tuple[int, int, int]]:
    """Triangles between two rings, by their angles: the edge whose middle comes first makes the next triangle.

    Equal rings need a hair's difference of angle, which says how their diagonals turn.
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
    """A sector of a cylinder, its top at y = levels[0] facing -y. radii and levels in mm; see `rings`."""
    flat, triangles = rings(radii, segments, quarters)
    corners = [np.column_stack([flat[:, 0], np.full(len(flat), y), flat[:, 1]]) for y in levels]
    prisms = [np.hstack([triangles, triangles + len(flat)]) + i * len(flat) for i in range(len(levels) - 1)]
    corners = np.concatenate(corners)
    radius = np.hypot(corners[:, 0], corners[:, 2])
    mesh = quadratic(np.column_stack([corners, radius]), split_prisms(np.concatenate(prisms)), _at_radius)
    mesh.nodes[np.abs(mesh.nodes) < 1e-12] = 0.0  # exactly on the planes of symmetry
    return mesh


def _at_radius(parameters: np.ndarray) -> np.ndarray:
    """Points (n, 3) in the direction of (x, z), at y and at the radius: parameters (n, 4) are x, y, z, radius."""
    points = parameters[:, :3].copy()
    length = np.hypot(points[:, 0], points[:, 2])
    points[:, [0, 2]] *= (parameters[:, 3] / np.where(length > 0.0, length, 1.0))[:, None]
    return points


def make_sensor(mesh: Mesh, fixed: np.ndarray, touchable: np.ndarray, points: np.ndarray) -> Sensor:
    """A sensor around a structured mesh, to be pressed like any other; its output are the given points (p, 3) mm.

    held (n,) or (n, 3) bool; touchable (f, 6). Its materials are the caller's.
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
        camera=None,
        held_regions={},
    )
