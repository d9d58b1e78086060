"""Nearest points and normals of triangulated surfaces."""

import numpy as np

from simgen.geometry.surface import ClosestPoint


def nearest_on_surface(
    vertices: np.ndarray, triangles: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Distance (n,) of points (n, 3) from a triangulated surface, and unit normals (n, 2, 3) at the nearest points.

    The first normal is interpolated between vertices and suits a curved surface. The second one is the facet's own and
    suits a crease.
    """
    nearest, distance, face = ClosestPoint(vertices, triangles)(points)
    corners = vertices[triangles[face]]
    weights = _barycentric(corners, nearest)
    interpolated = np.einsum("nk,nki->ni", weights, vertex_normals(vertices, triangles)[triangles[face]])
    facet = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    both = np.stack([interpolated, facet], axis=1)
    return distance, both / np.linalg.norm(both, axis=2, keepdims=True)


def vertex_normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Area-weighted unit normals (v, 3) of vertices; 0 at a vertex without triangles."""
    a, b, c = np.swapaxes(vertices[triangles], 0, 1)
    facet = np.cross(b - a, c - a)
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, triangles[:, corner], facet)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)


def _barycentric(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Barycentric coordinates (n, 3) of points (n, 3) in triangles (n, 3, 3)."""
    a, b, c = np.swapaxes(corners, 0, 1)
    whole = np.cross(b - a, c - a)
    area = np.einsum("ni,ni->n", whole, whole)
    of_b = np.einsum("ni,ni->n", np.cross(points - a, c - a), whole) / area
    of_c = np.einsum("ni,ni->n", np.cross(b - a, points - a), whole) / area
    return np.stack([1.0 - of_b - of_c, of_b, of_c], axis=1)
