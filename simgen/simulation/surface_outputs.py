"""Stress and contact traction at the vertices of an output mesh's surface."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
import warp as wp

from simgen.config.outputs import BY_NAME
from simgen.fem.device import launch_kernel, read
from simgen.fem.elements.nodal_stress import NodalStress
from simgen.fem.linear_solver.pattern import corners_to_nodes
from simgen.fem.precision import real
from simgen.geometry.interpolation import interpolation_matrix
from simgen.simulation.scene import Scene

wp.set_module_options({"enable_backward": False})

MAX_LANES = 64  # environments at a time; for each, nodal sums take as much memory as the states of a press


@wp.kernel
def to_vertices_kernel(
    row_starts: wp.array(dtype=wp.int32),
    columns: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.float64),
    nodal: wp.array3d(dtype=wp.float64),
    # outputs
    field_out: wp.array3d(dtype=wp.float32),
):
    """Apply a sparse matrix to nodal sums (node, component, lane); gives a field (lane, vertex, component)."""
    vertex, c, lane = wp.tid()
    total = real(0.0)
    for j in range(row_starts[vertex], row_starts[vertex + 1]):
        total += values[j] * nodal[columns[j], c, lane]
    field_out[lane, vertex, c] = wp.float32(total)


class _Field:
    """Sums at nodes (n, components, lane), made by ``add_to(sums, x, first)``, and a matrix (v, n) to vertices."""

    def __init__(self, add_to, matrix: sparse.csr_array, components: int, lanes: int, device):
        self.add_to, self.shape = add_to, (matrix.shape[0], components)
        self._matrix = [wp.array(each, dtype=wp.int32, device=device) for each in (matrix.indptr, matrix.indices)]
        self._matrix.append(wp.array(matrix.data, dtype=wp.float64, device=device))
        self._sums = wp.zeros((matrix.shape[1], components, lanes), dtype=wp.float64, device=device)
        self._found = wp.zeros((lanes, *self.shape), dtype=wp.float32, device=device)

    def take(self, x, count: int) -> np.ndarray:
        """Values (count, v, components) at vertices, in the first ``count`` active environments."""
        found, lanes = np.empty((count, *self.shape), np.float32), len(self._found)
        for first in range(0, count, lanes):
            self._sums.zero_()
            self.add_to(self._sums, x, first)
            some, device = min(lanes, count - first), self._found.device
            inputs, outputs = [*self._matrix, self._sums], [self._found]
            launch_kernel(to_vertices_kernel, dim=(*self.shape, some), inputs=inputs, outputs=outputs, device=device)
            [found[first : first + some]] = read(self._found[:some])
        return found


class SurfaceOutputs:
    """Measures a scene's surface outputs at the v surface vertices of the sensor's output mesh."""

    def __init__(self, scene: Scene):
        names = [output.name for output in scene.outputs if output.at_surface]
        self.scene, mesh, output = scene, scene.mesh, scene.sensor.output_mesh
        self._fields: dict[str, _Field] = {}
        if not names:
            return
        contact, unit = scene.indenter_contact, scene.material.youngs_modulus_pa
        of_nodes = sparse.csc_array(interpolation_matrix(mesh, scene.sensor.output_points[output.surface_vertices]))
        of_corners = sparse.csc_array(of_nodes @ corners_to_nodes(mesh.tetrahedra, len(mesh.nodes), mesh.n_corners))
        if "stress" in names:
            quadratic = len(scene.nodes) == len(mesh.nodes)
            weights = of_nodes if quadratic else of_corners
            nodes = np.flatnonzero(np.diff(weights.indptr))
            stress = NodalStress(scene.solver.elasticity, nodes)
            self._add("stress", stress.add_to, weights[:, nodes] * (unit / stress.volumes))
        if "traction" in names:
            # Only corners of faces carry traction. A vertex a little below a face also has weights at other corners:
            # those at the face's corners are rescaled to a sum of 1.
            weights = of_corners[:, contact.corners]
            share = weights.sum(axis=1)
            weights = sparse.diags_array(1.0 / np.where(share > 0.5, share, 1.0)) @ weights
            self._add("traction", contact.add_corner_forces, weights * (unit / contact.corner_areas))

    def _add(self, name: str, add_to, matrix):
        scene = self.scene
        lanes, (_, components) = min(MAX_LANES, scene.batch), BY_NAME[name].shape
        self._fields[name] = _Field(add_to, sparse.csr_array(matrix), components, lanes, scene.device)

    def take(self, name: str, count: int) -> np.ndarray:
        """Measure an output, (count, v, components) float32, Pa, in the first ``count`` active environments."""
        return self._fields[name].take(self.scene.solver.x, count)
