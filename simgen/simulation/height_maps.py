"""Height maps of a solution: rays of a camera's pixels meet the curved faces of the simulation mesh."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
import warp as wp

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
MAX_LANES = 256  # environments at a time; a map of 240 x 320 pixels and its points take 2 MB for each


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

    def take(self, count: int) -> list[np.ndarray]:
        """Height maps (height, width) float32, m, of the first ``count`` active environments.

        Pixels that lost the surface take the height of the nearest pixel that sees it.
        """
        lanes, points = self._displacement.shape
        solver, made, found = self._scene.solver, self._buffers, []
        for first in range(0, count, lanes):
            some = min(lanes, count - first)
            inputs = [*self._matrix, solver.x, solver.active.numbers[first:], 1.0 / MM_PER_M]
            outputs, device = [self._displacement], self._scene.device
            launch_kernel(points_kernel, dim=(points, some), inputs=inputs, outputs=outputs, device=device)
            self._maps.measure(self._displacement, made, some)
            height, holes = read(made.height[:some], made.holes[:some])
            # A CPU's arrays are views of the buffers. A GPU's are copies: another one would take as long as the rays.
            maps = list(height.copy() if made.height.device.is_cpu else height)
            for sample in np.flatnonzero(holes).tolist():
                maps[sample] = filled(maps[sample])
            found += maps
        return found
