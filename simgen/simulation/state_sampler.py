"""State sampler: reactions, displacements and overlap of a scene's solver, in all environments at once."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import warp as wp

from simgen.fem import batch_arrays
from simgen.fem.chunks import CHUNK, chunks
from simgen.fem.contact.contact import Resultants
from simgen.fem.device import Reading, combined, launch_kernel
from simgen.fem.elements.recovered_strain import RecoveredStrain
from simgen.fem.precision import real
from simgen.simulation.first_touch import dense_shapes
from simgen.simulation.height_maps import SolutionHeightMaps
from simgen.simulation.scene import Scene
from simgen.simulation.surface_outputs import SurfaceOutputs
from simgen.units import MM_PER_M

wp.set_module_options({"enable_backward": False})

SUBDIVISIONS = 6  # of a face's edges, for the points where overlap is measured


@wp.kernel
def reaction_kernel(
    internal: wp.array2d(dtype=wp.float64),
    surface: wp.array2d(dtype=wp.float64),
    fixed: wp.array(dtype=wp.int32),
    nodes: wp.int32,
    active: wp.array(dtype=wp.int32),
    # outputs
    reactions_out: wp.array2d(dtype=wp.float64),
):
    """Sum the forces on fixed nodes, by component."""
    c, i, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    total = real(0.0)
    for node in range(c * CHUNK, wp.min((c + 1) * CHUNK, nodes)):
        row = 3 * node + i
        if fixed[row] == 1:
            total += internal[row, env] + surface[row, env]
    wp.atomic_add(reactions_out, i, env, total)


@wp.kernel
def output_kernel(
    row_starts: wp.array(dtype=wp.int32),
    columns: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.float64),
    x: wp.array2d(dtype=wp.float64),
    environments: wp.array(dtype=wp.int32),
    # outputs
    displacement_out: wp.array3d(dtype=Any),
):
    """Interpolate displacements (environment in the list, vertex, component), m, from the simulation mesh's nodes."""
    vertex, i, k = wp.tid()
    env = environments[k]
    total = real(0.0)
    for j in range(row_starts[vertex], row_starts[vertex + 1]):
        total += values[j] * x[3 * columns[j] + i, env]
    displacement_out[k, vertex, i] = displacement_out.dtype(total / real(MM_PER_M))


for _kind in (wp.float64, wp.float32):
    wp.overload(output_kernel, {"displacement_out": wp.array3d(dtype=_kind)})


class Overlap(NamedTuple):
    """Overlap of rigid bodies with the gel, per environment. Overlap of core and support at rest does not count.

    deepest_mm : (env,) with indenter, core and support; negative without overlap
    of_edge : (env,) largest overlap over its face's edge
    room_mm : (env,) least distance between indenter and core where the indenter overlaps the skin. Negative if no skin
        is left between them; inf without overlap or core
    """

    deepest_mm: np.ndarray
    of_edge: np.ndarray
    room_mm: np.ndarray


class Measured(NamedTuple):
    """Measurements of a state, in the solver's units.

    contact, fixed : resultants of the indenter's contact, and of each fixed one
    reactions : (3, env) forces of the fixed nodes on the body
    least_det_F : (env,) lower bound over all elements, also between the solver's integration points
    inverted, stabilised : (env,) numbers of elements that are inverted somewhere, and that have a stabilisation
    displacement : (k, v, 3) m, of the output mesh, in the first active environments
    """

    contact: Resultants
    fixed: list[Resultants]
    reactions: np.ndarray
    least_det_F: np.ndarray
    inverted: np.ndarray
    stabilised: np.ndarray
    displacement: np.ndarray

    def keep(self, kept: np.ndarray) -> Measured:
        """Leave out displacements of measured environments that are not ``kept`` (k,) bool."""
        return self if kept.all() else self._replace(displacement=self.displacement[kept])


class StateSampler:
    """Measures the states of a scene's solver in the environments that have reached a point.

    The scene must be at rest when the sampler is made, as :meth:`Scene.reset` leaves it.
    """

    @classmethod
    def of(cls, scene: Scene) -> StateSampler:
        """Return the sampler of a scene; the first call makes it."""
        if scene.sampler is None:
            scene.sampler = cls(scene)
        return scene.sampler

    def __init__(self, scene: Scene):
        self.scene, device, batch = scene, scene.device, scene.batch
        to_output = scene.to_output.tocsr()
        self._weights = [wp.array(a.astype(np.int32), dtype=wp.int32, device=device)
                         for a in (to_output.indptr, to_output.indices)]  # fmt: skip
        self._weights.append(wp.array(to_output.data, dtype=wp.float64, device=device))
        # Results of thousands of presses on a GPU wait in host memory. Single precision halves them; it errs by 0.1 nm.
        kind = wp.float64 if wp.get_device(device).is_cpu else wp.float32
        self._displacement = wp.zeros((batch, to_output.shape[0], 3), dtype=kind, device=device)
        self._nodes = len(scene.nodes)
        self._sums = wp.zeros((3, batch), dtype=wp.float64, device=device)
        corners = scene.indenter_contact.host_faces.shape[1] == 3
        self._dense = wp.array(dense_shapes(SUBDIVISIONS, linear=corners), dtype=wp.float64, device=device)
        for contact in scene.fixed_contacts:
            contact.set_pose(np.tile(np.eye(4), (batch, 1, 1)))
        self.surface_outputs = SurfaceOutputs(scene)
        self._recovered: RecoveredStrain | None = None
        self._height_maps: SolutionHeightMaps | None = None
        self._rest_overlaps = [max(-self._nearest(contact).read()[0][0], 0.0) for contact in scene.fixed_contacts]

    def _nearest(self, contact, at_rest: float = 0.0) -> Reading:
        return contact.nearest(self.scene.solver.x, self._dense, at_rest)

    def measure(self, count: int) -> Reading:
        """Measure the active environments; a reading of `Measured`. The first ``count`` have displacements.

        The solver has measured the forces of these states.
        """
        scene, x = self.scene, self.scene.solver.x
        elasticity = scene.solver.elasticity
        readings = [
            scene.indenter_contact.resultants(x),
            elasticity.bound_det_F(x),
            elasticity.stabilised_elements(),
            self._reactions(),
            self._displacements(count),
            *(contact.resultants(x) for contact in scene.fixed_contacts),
        ]

        def value(contact, det_F, stabilised, reactions, displacement, *fixed) -> Measured:
            return Measured(contact, list(fixed), reactions, *det_F, stabilised, displacement)

        return combined(readings, value)

    def _reactions(self) -> Reading:
        """Sum the forces (3, env) of the fixed nodes on the body."""
        balance, solver = self.scene.solver.balance, self.scene.solver
        self._sums.zero_()
        inputs = [balance.internal, balance.surface, solver.fixed, self._nodes, solver.active]
        batch_arrays.launch(reaction_kernel, (chunks(self._nodes), 3), inputs, [self._sums])
        return Reading((self._sums,), lambda sums: sums)

    @property
    def displacement_type(self) -> type:
        """Type of displacements; that of a dataset is coarser."""
        return wp.dtype_to_numpy(self._displacement.dtype)

    def _displacements(self, count: int) -> Reading:
        """Interpolate displacements (count, v, 3) of the output mesh, m, in the first active environments."""
        solver, dim = self.scene.solver, (self._displacement.shape[1], 3, count)
        inputs, outputs = [*self._weights, solver.x, solver.active.numbers], [self._displacement]
        launch_kernel(output_kernel, dim=dim, inputs=inputs, outputs=outputs, device=self.scene.device)
        return Reading((self._displacement[:count],), lambda displacement: displacement)

    def error_energy(self, count: int) -> np.ndarray:
        """Energy (count,) E mm3 of the strain's error in the first active environments; see `RecoveredStrain`."""
        if self._recovered is None:
            self._recovered = RecoveredStrain(self.scene.solver.elasticity, self.scene.batch)
        return self._recovered.error_energy(self.scene.solver.x, count)

    def height_maps(self, count: int) -> np.ndarray:
        """Height maps (count, height, width) of the first active environments; see `SolutionHeightMaps.take`."""
        if self._height_maps is None:
            self._height_maps = SolutionHeightMaps(self.scene)
        return self._height_maps.take(count)

    def overlap(self) -> Reading:
        """Measure how far rigid bodies overlap the gel; a reading of `Overlap`.

        Points are denser than integration points.
        """
        scene, x, rests = self.scene, self.scene.solver.x, [0.0, *self._rest_overlaps]
        contacts, core = (scene.indenter_contact, *scene.fixed_contacts), scene.core_contact
        nearest = map(self._nearest, contacts, rests)
        room = [] if core is None else [scene.indenter_contact.room(x, self._dense, core)]

        def value(*found) -> Overlap:
            distances, of_edges = zip(*found[: len(contacts)], strict=True)
            depths = [-distance - at_rest for distance, at_rest in zip(distances, rests, strict=True)]
            left = found[-1] if room else np.full(scene.batch, np.inf)
            return Overlap(np.maximum.reduce(depths), np.maximum.reduce(of_edges), left)

        return combined([*nearest, *room], value)
