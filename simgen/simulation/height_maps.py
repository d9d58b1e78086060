"""Height maps of a solution: rays of a camera's pixels meet the curved faces of the simulation mesh."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
import warp as wp

from simgen.config.outputs import NOT_REACHED
from simgen.fem.device import launch_kernel, read
from simgen.geometry.subdivided_faces import subdivided_faces
from simgen.geometry.tetrahedra import SimulationMesh
from simgen.sensors.height_map import HeightMaps, coat, filled
from simgen.sensors.pinhole import Pinhole
from simgen.sensors.sensor import Camera
from simgen.units import MM_PER_M

wp.set_module_options({"enable_backward": False})

# Parts of a face's edge. Edges of 0.6 mm become flat pieces of 0.1 mm, which lie within 0.5 um of a sphere of 3 mm.
DIVISIONS = 6
MAX_LANES = 64  # environments at a time; a map of 240 x 320 pixels and its points take 2 MB for each
LARGEST = wp.constant(wp.float32(2**15 - 1))


@wp.kernel
def points_kernel(
    row_starts: wp.array(dtype=wp.int32),
    columns: wp.array(dtype=wp.int32),
    weights: wp.array(dtype=wp.float32),
    x: wp.array2d(dtype=wp.float64),
    environments: wp.array(dtype=wp.int32),
    scale: wp.float32,
    # outputs
    displacement_out: wp.array2d(dtype=wp.vec3f),
):
    """Interpolate displacements (environment in the list, point) from the simulation mesh's nodes."""
    point, k = wp.tid()
    env = environments[k]
    total = wp.vec3f()
    for j in range(row_starts[point], row_starts[point + 1]):
        row = 3 * columns[j]
        moved = wp.vec3f(wp.float32(x[row, env]), wp.float32(x[row + 1, env]), wp.float32(x[row + 2, env]))
        total += weights[j] * moved
    displacement_out[k, point] = scale * total


@wp.kernel
def steps_kernel(
    height: wp.array3d(dtype=wp.float32),
    per_m: wp.float32,
    # outputs
    steps_out: wp.array3d(dtype=wp.int16),
    holes_out: wp.array(dtype=wp.int32),
):
    """Round heights to steps. Pixels without a height, or with one that does not fit, become `NOT_REACHED`."""
    sample, row, column = wp.tid()
    value = height[sample, row, column]
    steps = wp.int16(NOT_REACHED)
    if not wp.isnan(value):
        whole = wp.rint(value * per_m)
        if wp.abs(whole) <= LARGEST:
            steps = wp.int16(whole)
        else:
            wp.atomic_add(holes_out, sample, 1)
    steps_out[sample, row, column] = steps


def solution_height_maps(
    mesh: SimulationMesh, camera: Camera, device: str = "cpu", quadratic: bool = True
) -> tuple[HeightMaps, sparse.csr_array]:
    """Make the height maps of a mesh's touchable faces, and the matrix (point, node) from nodes to their points.

    quadratic : False for an element whose faces are flat, with nodes at the corners alone
    """
    nodes = mesh.nodes if quadratic else mesh.nodes[: mesh.n_corners]
    faces = mesh.touchable if quadratic else mesh.touchable[:, :3]
    matrix, triangles = subdivided_faces(faces, len(nodes), DIVISIONS)
    pinhole, rest = Pinhole.of(camera), matrix @ nodes
    used, triangles = np.unique(coat(rest, triangles, pinhole), return_inverse=True)
    return HeightMaps(rest[used], triangles.reshape(-1, 3), pinhole, device), matrix[used]


class SolutionHeightMaps:
    """Height maps of the states of a scene with a camera.

    scene : a `simgen.simulation.scene.Scene`
    """

    def __init__(self, scene):
        self._scene, device = scene, scene.device
        quadratic = len(scene.nodes) == len(scene.mesh.nodes)
        self._maps, matrix = solution_height_maps(scene.mesh, scene.camera, device, quadratic)
        self._matrix = [wp.array(each, dtype=wp.int32, device=device) for each in (matrix.indptr, matrix.indices)]
        self._matrix.append(wp.array(matrix.data, dtype=wp.float32, device=device))
        lanes = min(MAX_LANES, scene.batch)
        self._buffers = self._maps.buffers(lanes)
        self._displacement = wp.empty((lanes, matrix.shape[0]), dtype=wp.vec3f, device=device)
        # Fresh host memory costs ten times as much as the rays: its pages are mapped one by one. So all is allocated
        # once, and maps leave the device as integers.
        shape = self._buffers.height.shape
        self._steps = wp.empty(shape, dtype=wp.int16, device=device)
        on_gpu = not wp.get_device(device).is_cpu
        self._host = wp.empty(shape, dtype=wp.int16, device="cpu", pinned=True) if on_gpu else self._steps
        self._found = np.empty((scene.batch, *shape[1:]), np.int16)

    def take(self, count: int) -> np.ndarray:
        """Height maps (count, height, width) int16, in the scene's steps, of the first active environments.

        Pixels that lost the surface, or whose height does not fit, take the height of the nearest other pixel. The
        array is valid until the next call.
        """
        lanes, points = self._displacement.shape
        scene, made, device = self._scene, self._buffers, self._scene.device
        for first in range(0, count, lanes):
            some = min(lanes, count - first)
            inputs = [*self._matrix, scene.solver.x, scene.solver.active.numbers[first:], 1.0 / MM_PER_M]
            outputs = [self._displacement]
            launch_kernel(points_kernel, dim=(points, some), inputs=inputs, outputs=outputs, device=device)
            self._maps.measure(self._displacement, made, some)
            dim, inputs = (some, *made.height.shape[1:]), [made.height, 1.0 / scene.height_step_m]
            launch_kernel(steps_kernel, dim=dim, inputs=inputs, outputs=[self._steps, made.holes], device=device)
            if self._host is not self._steps:
                wp.copy(self._host, self._steps, count=some * self._steps[0].size)
            [holes] = read(made.holes[:some])  # waits for the copy, too
            found = self._found[first : first + some]
            found[:] = self._host.numpy()[:some]
            for sample in np.flatnonzero(holes).tolist():
                found[sample] = filled(found[sample], found[sample] == NOT_REACHED)
        return self._found[:count]
