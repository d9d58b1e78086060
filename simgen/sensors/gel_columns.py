"""Columns of gel along a press axis: height of the surface, thickness, height of the rigid body behind.

A column is a line parallel to the press axis, on a square lattice around that axis. Seen from the indenter, a column
meets the touchable surface, the gel, and then the held back, or a gap and the rigid core. If a column leaves the gel
elsewhere, only its surface counts. Lengths are in mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from simgen.geometry.curved_tetrahedra import CORE, FREE, HELD
from simgen.sensors.sensor import Sensor
from simgen.units import MM_PER_M

wp.set_module_options({"enable_backward": False})
real, vec3, mat33 = wp.float64, wp.vec3d, wp.mat33d

BODY = 3  # kind of the core's own faces; faces of the gel are FREE, HELD or CORE
LAYERS = ENTRY, FREE_EXIT, HELD_EXIT, INNER_EXIT, BODY_ENTRY = range(5)  # first crossings of a column
# Kind of a face -> layers of a column that enters the body there, and of one that leaves it.
LAYER_OF = {FREE: (ENTRY, FREE_EXIT), HELD: (-1, HELD_EXIT), CORE: (-1, INNER_EXIT), BODY: (BODY_ENTRY, -1)}


@dataclass(frozen=True)
class Lattice:
    """Columns at (i, k) spacing, |i| <= half_x and |k| <= half_z, in the x-z plane of the indenter's frame, mm."""

    spacing: float
    half_x: int
    half_z: int

    @property
    def points(self) -> np.ndarray:
        """(columns, 2) mm, x and z; z runs fastest."""
        x = self.spacing * np.arange(-self.half_x, self.half_x + 1)
        z = self.spacing * np.arange(-self.half_z, self.half_z + 1)
        return np.stack(np.meshgrid(x, z, indexing="ij"), axis=-1).reshape(-1, 2)


@dataclass(frozen=True)
class Columns:
    """Columns under n poses, each (n, columns) mm. Heights are along +y of the indenter's frame.

    surface : height of the touchable surface; inf in columns that miss it
    rigid : height of the held back or the core; inf in columns that count no gel
    thickness : of the gel before the back, or of the skin before the gap; 1 where ``rigid`` is inf
    """

    surface: np.ndarray
    rigid: np.ndarray
    thickness: np.ndarray


@wp.kernel
def columns_kernel(
    vertices: wp.array(dtype=vec3),
    rotation: wp.array(dtype=mat33),
    origin: wp.array(dtype=vec3),
    spacing: wp.float64,
    faces: wp.array(dtype=wp.vec3i),
    kinds: wp.array(dtype=wp.int32),
    layer_of: wp.array2d(dtype=wp.int32),
    half_x: wp.int32,
    half_z: wp.int32,
    # outputs
    seen: wp.array2d(dtype=vec3),
    layers: wp.array3d(dtype=wp.float64),
):
    """Least height (pose, layer, column) at which each column meets the faces of each layer.

    ``seen`` holds the vertices (pose, vertex) in each indenter's frame: x and z in units of the spacing, y in mm. One
    thread takes all of a pose: no other thread writes its columns, and its vertices stay in the cache.
    """
    n = wp.tid()
    for i in range(vertices.shape[0]):
        own = wp.transpose(rotation[n]) * (vertices[i] - origin[n])
        seen[n, i] = vec3(own[0] / spacing, own[1], own[2] / spacing)
    low, high = -real(half_x), real(half_x)
    left, right = -real(half_z), real(half_z)
    for f in range(faces.shape[0]):
        face = faces[f]
        a, b, c = seen[n, face[0]], seen[n, face[1]], seen[n, face[2]]
        first_x = wp.ceil(wp.max(wp.min(wp.min(a[0], b[0]), c[0]), low))
        last_x = wp.min(wp.max(wp.max(a[0], b[0]), c[0]), high)
        first_z = wp.ceil(wp.max(wp.min(wp.min(a[2], b[2]), c[2]), left))
        last_z = wp.min(wp.max(wp.max(a[2], b[2]), c[2]), right)
        if first_x > last_x or first_z > last_z:
            continue
        # Twice the signed area of the face seen along the axis: the y component of its normal.
        area = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2])
        layer = layer_of[kinds[f], wp.where(area > real(0.0), 1, 0)]
        if area == real(0.0) or layer < 0:
            continue
        edge = real(-1.0e-9)  # a column on an edge belongs to both faces, so that no column falls between faces
        x = first_x
        while x <= last_x:
            z = first_z
            while z <= last_z:
                u = ((c[2] - b[2]) * (x - b[0]) - (c[0] - b[0]) * (z - b[2])) / area
                v = ((a[2] - c[2]) * (x - c[0]) - (a[0] - c[0]) * (z - c[2])) / area
                w = real(1.0) - u - v
                meets = wp.min(wp.min(u, v), w) >= edge
                height = wp.where(meets, u * a[1] + v * b[1] + w * c[1], real(wp.inf))
                column = wp.int32(x - low) * (2 * half_z + 1) + wp.int32(z - left)
                layers[n, layer, column] = wp.min(layers[n, layer, column], height)  # faster than a branch
                z += real(1.0)
            x += real(1.0)


@wp.kernel
def thickness_kernel(
    layers: wp.array3d(dtype=wp.float64),
    # outputs
    surface: wp.array2d(dtype=wp.float64),
    rigid: wp.array2d(dtype=wp.float64),
    thickness: wp.array2d(dtype=wp.float64),
):
    """Heights and thickness (pose, column) of `Columns` from the least heights (pose, layer, column) of the layers."""
    n, m = wp.tid()
    nothing = wp.float64(wp.inf)
    entry, free, held = layers[n, ENTRY, m], layers[n, FREE_EXIT, m], layers[n, HELD_EXIT, m]
    inner, body = layers[n, INNER_EXIT, m], layers[n, BODY_ENTRY, m]
    on_back = held < free and held < inner
    on_core = inner < free and inner < held and body < nothing
    surface[n, m] = entry
    rigid[n, m] = nothing
    thickness[n, m] = wp.float64(1.0)
    if on_back or on_core:
        gel = wp.where(on_back, held, inner) - entry
        if gel > wp.float64(0.0):
            rigid[n, m] = wp.where(on_back, held, body)
            thickness[n, m] = gel


class Buffers:
    """Arrays for the columns of a few poses, which are used again and again: new memory takes longer than the columns.

    surface, rigid, thickness : (pose, column) mm, as in `Columns`
    rotation (pose, 3, 3), origin (pose, 3) mm : poses, indenter frame -> sensor frame
    """

    def __init__(self, poses: int, vertices: int, columns: int):
        self.rotation, self.origin = np.empty((poses, 3, 3)), np.empty((poses, 3))
        self.frames = [
            wp.array(self.rotation, dtype=mat33, device="cpu", copy=False),
            wp.array(self.origin, dtype=vec3, device="cpu", copy=False),
        ]
        self.seen = wp.empty((poses, vertices), dtype=vec3, device="cpu")
        self.layers = wp.empty((poses, len(LAYERS), columns), dtype=real, device="cpu")
        self.columns = [wp.empty((poses, columns), dtype=real, device="cpu") for _ in range(3)]


class GelColumns:
    """Surfaces of one sensor, ready to be cut into `Columns` for any pose of an indenter."""

    def __init__(self, sensor: Sensor):
        wp.load_module(__name__, device="cpu")  # threads that launch kernels would each compile them
        vertices, faces = sensor.surface.vertices, sensor.surface.faces
        kinds = np.asarray(sensor.surface_region, dtype=np.int32)
        if sensor.core is not None:
            faces = np.concatenate([faces, sensor.core.faces + len(vertices)])
            vertices = np.concatenate([vertices, sensor.core.vertices])
            kinds = np.concatenate([kinds, np.full(len(sensor.core.faces), BODY, np.int32)])
        self._vertices = wp.array(vertices * MM_PER_M, dtype=vec3, device="cpu")
        self._surfaces = [
            wp.array(np.ascontiguousarray(faces, dtype=np.int32), dtype=wp.vec3i, device="cpu"),
            wp.array(kinds, dtype=wp.int32, device="cpu"),
            wp.array([LAYER_OF[kind] for kind in range(len(LAYER_OF))], dtype=wp.int32, device="cpu"),
        ]

    def __call__(self, poses: np.ndarray, lattice: Lattice) -> Columns:
        """Cut columns under poses (n, 4, 4) m, indenter frame -> sensor frame."""
        buffers = self.buffers(len(poses), lattice)
        self.cut(poses, lattice, buffers)
        return Columns(*(each.numpy() for each in buffers.columns))

    def buffers(self, poses: int, lattice: Lattice) -> Buffers:
        """Make arrays for the columns of so many poses."""
        return Buffers(poses, len(self._vertices), len(lattice.points))

    def cut(self, poses: np.ndarray, lattice: Lattice, into: Buffers):
        """Cut columns under poses (n, 4, 4) m into the first n rows of arrays for at least so many."""
        count = len(poses)
        into.rotation[:count], into.origin[:count] = poses[:, :3, :3], poses[:, :3, 3] * MM_PER_M
        into.layers.fill_(np.inf)
        inputs = [self._vertices, *into.frames, lattice.spacing, *self._surfaces, lattice.half_x, lattice.half_z]
        wp.launch(columns_kernel, count, inputs=inputs, outputs=[into.seen, into.layers], device="cpu")
        dim = count, into.layers.shape[2]
        wp.launch(thickness_kernel, dim, inputs=[into.layers], outputs=into.columns, device="cpu")
