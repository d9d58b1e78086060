"""Distances between our parametric bodies and published meshes, in mm."""

import numpy as np
import trimesh

from simgen.geometry.curved_tetrahedra import CORE, FREE
from simgen.geometry.rigid_shape import signed_distance
from simgen.geometry.signed_distance import RigidShape
from simgen.geometry.surface import ClosestPoint
from simgen.sensors.sensor_geometry import SensorGeometry
from simgen.units import MM

TIP_MM = 3.0  # height of the part of an indenter that can touch


def touchable_distances(ours: SensorGeometry, published: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """Measure distances from our touchable surface to the published one (faces,), and back (points,).

    The points are the published vertices and face centres whose nearest point of our body is on its touchable surface.
    """
    free = ours.true.region == FREE
    there = ClosestPoint(published.vertices, published.faces)(ours.true.surface.triangles_center[free])[1]
    _, back, face = ours.true.closest(np.concatenate([published.vertices, published.triangles_center]))
    return there / MM, back[free[face]] / MM


def wall_thickness(ours: SensorGeometry, published: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """Measure the skin's wall in both bodies, at face centres of the published outer surface."""
    inner = ours.true.region == CORE
    _, _, face = ours.true.closest(published.triangles_center)
    points = published.triangles_center[~inner[face]]
    own = ours.true.surface
    on_ours = ours.true.closest(points)[0]
    walls = (
        ClosestPoint(own.vertices, own.faces[inner])(on_ours)[1],
        ClosestPoint(published.vertices, published.faces[inner[face]])(points)[1],
    )
    return walls[0] / MM, walls[1] / MM


def gel_thickness(ours: SensorGeometry, published: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """Measure the thickness of both DIGIT gels on a grid of (x, z), at least 1 mm inside the outline."""
    grid = np.stack(np.meshgrid(np.arange(-19, 4, 0.5), np.arange(-8, 8.1, 0.5)), axis=-1).reshape(-1, 2)
    grid = grid[(grid[:, 0] > -10.86) | (np.hypot(grid[:, 0] + 10.86, grid[:, 1]) < 8.2)]
    return _thickness(ours.true.surface, grid), _thickness(published, grid)


def _cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]


def _thickness(surface: trimesh.Trimesh, grid: np.ndarray) -> np.ndarray:
    """Distance from the lowest y of a surface at (x, z) to its flat back, by triangles seen along y."""
    corners = surface.triangles[surface.face_normals[:, 1] < -0.05] / MM
    a, b, c = (corners[:, k][:, [0, 2]] for k in range(3))
    area = _cross(b - a, c - a)
    lowest = np.full(len(grid), np.nan)
    for i, p in enumerate(grid):
        weights = np.stack([_cross(b - p, c - p), _cross(c - p, a - p), _cross(a - p, b - p)]) / area
        hit = (weights > -1e-9).all(axis=0)
        lowest[i] = (weights[:, hit] * corners[hit, :, 1].T).sum(axis=0).min()
    return surface.bounds[1, 1] / MM - lowest


def tip_distances(shape: RigidShape, published: trimesh.Trimesh) -> np.ndarray:
    """Measure signed distances of published vertices of an indenter's tip from our shape."""
    vertices = published.vertices / MM
    return signed_distance(shape, vertices[vertices[:, 1] > -TIP_MM])[0]
