"""Rigid shapes made on the host, analytic or sampled from a closed mesh, and their signed distance at points.

Shapes and points are in mm, meshes in m.
"""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import scipy.ndimage
import trimesh
import warp as wp

from simgen.errors import InputError
from simgen.geometry.signed_distance import Kind, RigidShape, probe

wp.set_module_options({"enable_backward": False})

MOST_GRID_POINTS = 64e6  # of a sampled shape: 512 MB


def rigid_shape(kind: Kind, *size_mm: float) -> RigidShape:
    """Make an analytic shape; the sizes (mm) in the order of `Kind`."""
    shape = RigidShape()
    shape.kind = int(kind)
    shape.size = wp.vec4d(*size_mm, *([0.0] * (4 - len(size_mm))))
    shape.coefficients = wp.empty((0, 0, 0), dtype=wp.float64, device="cpu")
    return shape


def lateral_reach(shape: RigidShape) -> float:
    """Largest distance of the shape, or of the grid of a sampled shape, from the y axis, mm."""
    kind, size = Kind(shape.kind), np.array(shape.size)
    if kind is Kind.SAMPLED:
        low = np.array(shape.grid_origin)
        high = low + shape.grid_spacing * (np.array(shape.coefficients.shape) - 1)
        x, _, z = np.maximum(np.abs(low), np.abs(high))
        return float(np.hypot(x, z))
    if kind is Kind.CYLINDER:
        return float(np.hypot(size[0], size[1]))
    return float(size[0] * np.sqrt(2.0) if kind in (Kind.CUBE, Kind.TEXTURE) else size[0])


def highest(shape: RigidShape) -> float:
    """Upper bound of the shape along y, mm: its tip, or the top of a sampled shape's grid."""
    if Kind(shape.kind) is not Kind.SAMPLED:
        return 0.0
    return float(np.array(shape.grid_origin)[1] + shape.grid_spacing * (shape.coefficients.shape[1] - 1))


@wp.kernel
def _mesh_distance_kernel(
    mesh: wp.uint64,
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array2d(dtype=wp.int32),
    reach: wp.float32,
    points: wp.array(dtype=wp.vec3d),
    distance_out: wp.array(dtype=wp.float64),
):
    i = wp.tid()
    x = points[i]
    # The query finds the triangle in float32; the distance to it is computed in float64.
    hit = wp.mesh_query_point_sign_winding_number(mesh, wp.vec3(x), reach)
    a = vertices[triangles[hit.face, 0]]
    b = vertices[triangles[hit.face, 1]]
    c = vertices[triangles[hit.face, 2]]
    u, v = wp.float64(hit.u), wp.float64(hit.v)
    nearest = u * a + v * b + (wp.float64(1.0) - u - v) * c
    distance_out[i] = wp.float64(hit.sign) * wp.length(x - nearest)


def mesh_distance(mesh: trimesh.Trimesh, points_mm: np.ndarray, device: str = "cpu") -> np.ndarray:
    """Signed distance (n,) mm, negative inside, of a closed mesh (m) at points (n, 3) mm."""
    vertices = np.asarray(mesh.vertices) * 1e3
    points = np.ascontiguousarray(points_mm, dtype=np.float64).reshape(-1, 3)
    triangles = np.asarray(mesh.faces, dtype=np.int32)
    surface = wp.Mesh(
        points=wp.array(vertices, dtype=wp.vec3, device=device),
        indices=wp.array(triangles.ravel(), dtype=wp.int32, device=device),
        support_winding_number=True,
    )
    inputs = [
        surface.id,
        wp.array(vertices, dtype=wp.vec3d, device=device),
        wp.array(triangles, dtype=wp.int32, device=device),
        2.0 * np.ptp(np.vstack([vertices, points]), axis=0).sum(),
        wp.array(points, dtype=wp.vec3d, device=device),
    ]
    distance = wp.empty(len(points), dtype=wp.float64, device=device)
    wp.launch(_mesh_distance_kernel, dim=len(points), inputs=inputs, outputs=[distance], device=device)
    return distance.numpy()


def grid_counts(extents_m: np.ndarray, spacing_mm: float, margin_mm: float) -> np.ndarray:
    """Number of grid points (3,) along each axis of a `sampled_shape` with these extents (3,)."""
    # Two more layers on each side: the spline of the last cell, and the mirror condition at the edge.
    return np.ceil((1e3 * extents_m + 2.0 * margin_mm) / spacing_mm).astype(int) + 5


def sampled_shape(mesh: trimesh.Trimesh, spacing_mm: float, margin_mm: float, device: str = "cpu") -> RigidShape:
    """Sample the signed distance of a closed mesh (m) on ``device``, see `sampled_distance`.

    Raises InputError if the mesh is not closed or the grid is too large.
    """
    if not mesh.is_watertight:
        raise InputError("a sampled shape needs a closed (watertight) surface; this one has open edges")
    measure = partial(mesh_distance, mesh, device=device)
    return sampled_distance(measure, mesh.bounds * 1e3, spacing_mm, margin_mm)


def sampled_distance(
    distance: Callable[[np.ndarray], np.ndarray], bounds_mm: np.ndarray, spacing_mm: float, margin_mm: float
) -> RigidShape:
    """Make a cubic B-spline of a signed distance. It is twice differentiable, so it has a curvature.

    distance: function of the points (x, y, z, 3) mm of a grid that returns their distances (x * y * z) mm in any shape.
    bounds_mm: (2, 3) bounds of the body. The grid reaches ``margin_mm`` beyond them.

    Outside the grid, the distance to the grid is added. Raises InputError if the grid would have more than
    `MOST_GRID_POINTS`.
    """
    low = bounds_mm[0] - margin_mm - 2.0 * spacing_mm
    counts = grid_counts(1e-3 * np.ptp(bounds_mm, axis=0), spacing_mm, margin_mm)
    if counts.prod() > MOST_GRID_POINTS:
        allowed = f"allowed: {MOST_GRID_POINTS:.2g}"
        raise InputError(f"spacing_mm: {spacing_mm:g} makes {counts.prod():.2g} grid points; {allowed}")
    axes = [low[axis] + spacing_mm * np.arange(counts[axis]) for axis in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    values = distance(points).reshape(counts)
    shape = RigidShape()
    shape.kind = int(Kind.SAMPLED)
    shape.grid_origin = wp.vec3d(*low)
    shape.grid_spacing = spacing_mm
    coefficients = scipy.ndimage.spline_filter(values, order=3, mode="mirror")
    shape.coefficients = wp.array(coefficients, dtype=wp.float64, device="cpu")
    return shape


def shape_array(shapes: Sequence[RigidShape], device: str = "cpu") -> wp.array:
    """Put one shape per environment into an array on ``device``.

    The array keeps a reference to its shapes, because a Warp array of structs holds bare pointers to their arrays.
    """
    moved = {id(shape): shape.to(device) for shape in shapes}
    placed = [moved[id(shape)] for shape in shapes]
    array = wp.array(placed, dtype=RigidShape, device=device)
    array.shapes = placed
    return array


@wp.kernel
def _probe_kernel(
    shapes: wp.array(dtype=RigidShape),
    points: wp.array(dtype=wp.vec3d),
    distance_out: wp.array(dtype=wp.float64),
    normal_out: wp.array(dtype=wp.vec3d),
    curvature_out: wp.array(dtype=wp.mat33d),
):
    i = wp.tid()
    result = probe(shapes[i % shapes.shape[0]], points[i])
    distance_out[i] = result.distance
    normal_out[i] = result.normal
    curvature_out[i] = result.curvature


def signed_distance(
    shape: "RigidShape | Sequence[RigidShape]", points_mm: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance (n,) mm, normal (n, 3) and curvature (n, 3, 3) 1/mm at points (n, 3) mm in the shape's frame.

    Given b shapes, point i belongs to shape ``i % b``.
    """
    shapes = shape if isinstance(shape, Sequence) else [shape]
    points = np.ascontiguousarray(points_mm, dtype=np.float64).reshape(-1, 3)
    inputs = [shape_array(shapes), wp.array(points, dtype=wp.vec3d, device="cpu")]
    outputs = [wp.empty(len(points), dtype=each, device="cpu") for each in (wp.float64, wp.vec3d, wp.mat33d)]
    wp.launch(_probe_kernel, dim=len(points), inputs=inputs, outputs=outputs, device="cpu")
    return tuple(each.numpy() for each in outputs)
