"""Contact of one surface with one rigid shape per environment, as a term of the solver.

The formulas are in ``traction.py``; the kernels of ``contact_forces``, ``contact_history`` (multipliers and slip) and
``contact_results`` gather and scatter. The touchable surface meets the indenter, the BioTac's inner skin its core, the
DIGIT's rim the plate below it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import warp as wp

from simgen.fem import batch_arrays
from simgen.fem.blocks import zeros
from simgen.fem.contact.candidates import find_candidates_kernel, no_candidates_kernel
from simgen.fem.contact.forces import (
    contact_action_kernel,
    contact_blocks_kernel,
    contact_diagonal_kernel,
    contact_residual_kernel,
    contact_tangent_kernel,
)
from simgen.fem.contact.multipliers import (
    MOST_IN_INCREMENT,
    MOST_STIFFENING,
    anchor_kernel,
    carry_kernel,
    change_kernel,
    extrapolate_kernel,
    stiffen_kernel,
    update_kernel,
)
from simgen.fem.contact.results import corner_forces_kernel, gap_kernel, nearest_kernel, resultant_kernel, room_kernel
from simgen.fem.contact.traction import Surface
from simgen.fem.device import read
from simgen.fem.elements.element import Element, face_geometry
from simgen.fem.material.neo_hookean import mat33, vec3
from simgen.geometry.rigid_shape import shape_array
from simgen.geometry.signed_distance import RigidShape

wp.set_module_options({"enable_backward": False})


class Resultants(NamedTuple):
    """A contact as a whole, per environment.

    force : (env, 3) on the sensor, in solver units
    moment : (env, 3) about the origin
    rms_penetration, max_penetration : (env,) mm
    area : (env,) mm2, contact area as it is at rest
    slip_share : (env,) share of the contact area where friction is at its limit; 0 without contact
    """

    force: np.ndarray
    moment: np.ndarray
    rms_penetration: np.ndarray
    max_penetration: np.ndarray
    area: np.ndarray
    slip_share: np.ndarray


class Contact:
    """A contact term: faces (f, 6) of the rest mesh (nodes in mm) against a rigid shape per environment."""

    def __init__(self, element: Element, nodes, faces, stiffness: tuple[float, float], friction: float, device, active):
        self.device, self.active, self.friction = device, active, friction
        self.n_env = active.shape[0]
        geometry = face_geometry(element, nodes, faces)
        faces = np.ascontiguousarray(faces[:, : geometry.shapes.shape[1]], dtype=np.int32)
        corners, slots = np.unique(faces[:, :3], return_inverse=True)
        slots = slots.reshape(-1, 3).astype(np.int32)
        weights = np.zeros(len(corners))
        edges = np.sqrt(2.0 * geometry.areas.sum(axis=1))
        np.add.at(weights, slots, edges[:, None] * (geometry.areas @ geometry.multiplier_shapes))
        self.host_faces, self.n_slots = faces, len(corners)
        self.corners, self.corner_areas = corners, np.zeros(len(corners))  # nodes; mm2, shares of the faces' areas
        np.add.at(self.corner_areas, slots, geometry.areas @ geometry.multiplier_shapes)
        self.weights = wp.array(weights, dtype=wp.float64, device=device)
        self.edge = float(np.sqrt((edges**2).mean()))  # mm, of a mean face

        s = self.surface = Surface()
        s.positions = wp.array(nodes, dtype=vec3, device=device)
        s.faces = wp.array(faces, dtype=wp.int32, device=device)
        s.slots = wp.array(slots, dtype=wp.int32, device=device)
        s.shapes = wp.array(geometry.shapes, dtype=wp.float64, device=device)
        s.multiplier_shapes = wp.array(geometry.multiplier_shapes, dtype=wp.float64, device=device)
        s.areas = wp.array(geometry.areas, dtype=wp.float64, device=device)
        s.edges = wp.array(edges, dtype=wp.float64, device=device)
        s.gap_offset = wp.zeros(geometry.areas.shape, dtype=wp.float64, device=device)
        s.shape_of = wp.zeros(self.n_env, dtype=wp.int32, device=device)
        s.rotation = wp.array(np.tile(np.eye(3), (self.n_env, 1, 1)), dtype=mat33, device=device)
        s.origin = wp.zeros(self.n_env, dtype=vec3, device=device)
        self._points = (*geometry.areas.shape, self.n_env)
        s.anchor = wp.zeros(self._points, dtype=vec3, device=device)
        s.normal = wp.zeros((self.n_slots, self.n_env), dtype=wp.float64, device=device)
        s.tangential = wp.zeros((self.n_slots, self.n_env), dtype=vec3, device=device)
        every = np.tile(np.arange(len(faces))[:, None], self.n_env)
        s.candidates = wp.array(every, dtype=wp.int32, device=device)
        s.count = wp.full(self.n_env, len(faces), dtype=wp.int32, device=device)
        self._is_candidate = wp.zeros((len(faces), self.n_env), dtype=wp.int32, device=device)
        self._travel = wp.zeros(self.n_env, dtype=wp.float64, device=device)
        s.stiffness, s.friction_stiffness = stiffness
        s.stiffening = wp.ones((len(faces), self.n_env), dtype=wp.float64, device=device)
        self._stiffening = wp.ones_like(s.stiffening)  # of the increment that begins
        s.friction = friction

        self._tangent = zeros(geometry.areas.size, self.n_env, device)  # by candidates, not by faces
        self._touching = wp.zeros((len(faces), self.n_env), dtype=wp.int32, device=device)
        self._sums = wp.zeros((self.n_slots, self.n_env), dtype=wp.vec4d, device=device)
        self._change = wp.zeros((2, self.n_env), dtype=wp.float64, device=device)
        self._carried = wp.zeros(self._points, dtype=vec3, device=device)
        self._resultants = [wp.zeros(self.n_env, dtype=vec3, device=device) for _ in range(2)]
        self._resultants.append(wp.zeros((4, self.n_env), dtype=wp.float64, device=device))
        self._least, self._largest = (wp.zeros(self.n_env, dtype=wp.float64, device=device) for _ in range(2))
        self._start_rotation, self._start_origin = wp.zeros_like(s.rotation), wp.zeros_like(s.origin)
        self._saved = [wp.zeros_like(array) for array in self._history()]
        self._before = wp.zeros_like(s.normal), wp.zeros_like(s.tangential)  # where the last increment began

    def _launch(self, kernel, inputs, outputs, rows: int | tuple[int, ...] = 0):
        batch_arrays.launch(kernel, rows or len(self.host_faces), [self.surface, *inputs], outputs)

    def set_shapes(self, shapes: list[RigidShape], count_overlap_as_touching: wp.array | None = None):
        """Give the environments rigid shapes, one each or (until :meth:`choose`) one for all; forget all tractions.

        With ``count_overlap_as_touching`` (a state), points that overlap the shape there have their gap counted from
        there: at rest a skin may lie on its core to within the accuracy of both meshes.
        """
        s = self.surface
        s.rigid = shape_array(shapes, self.device)
        self.choose(np.arange(self.n_env) if len(shapes) == self.n_env else np.zeros(self.n_env))
        s.normal.zero_()
        s.tangential.zero_()
        self._is_candidate.zero_()
        s.gap_offset.zero_()
        if count_overlap_as_touching is not None:
            overlap = np.maximum(-self.gap(count_overlap_as_touching)[:, :, 0], 0.0)
            s.gap_offset = wp.array(overlap, dtype=wp.float64, device=self.device)

    def choose(self, shape_of: np.ndarray):
        """Which of the shapes each environment (env,) has."""
        self.surface.shape_of.assign(shape_of.astype(np.int32))

    def forget(self, marked):
        """Drop the tractions of the listed environments (env,)."""
        for array in (self.surface.normal, self.surface.tangential, self._is_candidate, *self._before):
            batch_arrays.clear(marked, array)

    def set_pose(self, poses: np.ndarray):
        """Place the shapes: (env, 4, 4), shape frame -> sensor frame, mm."""
        self.surface.rotation.assign(np.ascontiguousarray(poses[:, :3, :3]))
        self.surface.origin.assign(np.ascontiguousarray(poses[:, :3, 3]))

    def gap(self, x) -> np.ndarray:
        """Signed distance at all quadrature points: (face, q, env), mm."""
        gap = wp.zeros(self._points, dtype=wp.float64, device=self.device)
        self._launch(gap_kernel, [x, self.active], [gap], self._points[:2])
        return gap.numpy()

    def begin_increment(self, x_start, x_predicted, start_poses, poses, travel: np.ndarray):
        """Start an increment of the active environments at ``x_start`` and ``start_poses``.

        The prediction tells where points enter contact, ``travel`` (env,) mm how far they may be from where they end.
        Shapes of other environments stay at ``poses``. The tractions are saved.
        """
        for array, saved in zip(self._history(), self._saved, strict=True):
            batch_arrays.copy(array, self.active, saved)
        self.set_pose(poses)
        self._find_candidates(x_predicted, travel)  # faces with multipliers among them: none else carries slip
        self.set_pose(start_poses)
        self._launch(stiffen_kernel, [x_start, MOST_STIFFENING, self.active], [self._stiffening])
        if self.friction > 0.0:
            wp.copy(self._start_rotation, self.surface.rotation)
            wp.copy(self._start_origin, self.surface.origin)
            inputs = [x_start, self._saved[-1], self._stiffening, self.active]
            self._launch(carry_kernel, inputs, [self._carried])
        self.set_pose(poses)
        if self.friction > 0.0:
            start = [self._start_rotation, self._start_origin]
            inputs = [x_start, x_predicted, *start, self._carried, self.active]
            self._launch(anchor_kernel, inputs, [self.surface.anchor])
        batch_arrays.copy(self._stiffening, self.active, self.surface.stiffening)

    def stiffen(self, x):
        """Raise the stiffness of faces that overlap the shape too far at x, within an increment."""
        batch_arrays.copy(self.surface.stiffening, self.active, self._stiffening)
        self._launch(stiffen_kernel, [x, MOST_IN_INCREMENT, self.active], [self._stiffening])
        batch_arrays.copy(self._stiffening, self.active, self.surface.stiffening)

    def extrapolate(self, factor: np.ndarray):
        """Let the multipliers of the active environments start this increment where ``factor`` (env,) times what the
        last one that was kept has changed would lead them.
        """
        inputs = [*self._before, self.active.factors(factor), self.active]
        self._launch(extrapolate_kernel, inputs, [], self.n_slots)

    def keep(self, marked):
        """The increments of the listed environments (env,) have converged: the next ones go on along them."""
        for saved, before in zip(self._saved[:2], self._before, strict=True):
            batch_arrays.copy(saved, marked, before)

    def _find_candidates(self, x, travel: np.ndarray):
        """Faces that can touch in the active environments, where points may be off by ``travel`` (env,) mm."""
        s = self.surface
        self._travel.assign(travel)
        batch_arrays.launch(no_candidates_kernel, (), [self.active], [s.count])
        outputs = [s.count, s.candidates, self._is_candidate]
        self._launch(find_candidates_kernel, [x, self._travel, self.active], outputs)

    def _history(self):
        s = self.surface
        return s.normal, s.tangential, s.anchor.reshape((-1, self.n_env)), s.stiffening, self._is_candidate

    def restore(self, marked):
        """Return the listed environments (env,) to where their increment began."""
        for array, saved in zip(self._history(), self._saved, strict=True):
            batch_arrays.copy(saved, marked, array)

    def residual(self, x, residual_out):
        """Add the forces; keep what an update of the multipliers would do at x."""
        self._sums.zero_()
        self._launch(contact_residual_kernel, [x, self.active], [residual_out, self._sums])

    def multiplier_change(self) -> wp.array:
        """Squares (2, env) of L2 norms, times `edge`, on the device: of the change that an update would make at the
        last ``residual``, and of what it leads to.
        """
        self._change.zero_()
        inputs = [self.weights, self._sums, self.active]
        self._launch(change_kernel, inputs, [self._change], self.n_slots)
        return self._change

    def update_multipliers(self):
        """Project the tractions of the last ``residual`` onto the multipliers."""
        self._launch(update_kernel, [self.weights, self._sums, self.active], [], self.n_slots)

    def linearize(self, x):
        self._launch(contact_tangent_kernel, [x, self.active], [self._tangent, self._touching])

    def tangent(self, v, action_out):
        """Action of the derivative at the state of the last ``linearize``."""
        self._launch(contact_action_kernel, [self._tangent, self._touching, v, self.active], [action_out])

    def blocks(self, block_index, blocks_out, linear: bool):
        """Add the derivative by displacements, or by linear ones alone, as 3 x 3 blocks between nodes or corners."""
        shapes = self.surface.multiplier_shapes if linear else self.surface.shapes
        inputs = [self._tangent, self._touching, shapes, self.active, block_index]
        self._launch(contact_blocks_kernel, inputs, [blocks_out])

    def diagonal(self, diagonal_out):
        """Add the 3 x 3 blocks of each node's displacement by itself."""
        self._launch(contact_diagonal_kernel, [self._tangent, self._touching, self.active], [diagonal_out])

    def resultants(self, x) -> Resultants:
        """Measure the contact at state x."""
        for array in self._resultants:
            array.zero_()
        self._launch(resultant_kernel, [x, self.active], self._resultants)
        force, moment, (area, squared, deepest, sliding) = map(np.copy, read(*self._resultants))
        divisor = np.where(area > 0.0, area, 1.0)
        rms = np.sqrt(squared / divisor)
        return Resultants(force, moment, rms, np.maximum(deepest, 0.0), area, sliding / divisor)

    def add_corner_forces(self, sums: wp.array, x, first: int = 0):
        """Add the forces on the sensor at state x, shared among `corners`, to sums (corner, 3, lane).

        Over `corner_areas` they are tractions per rest area. Lanes are the active environments from ``first`` on.
        """
        dim, inputs = (len(self.host_faces), sums.shape[2]), [self.surface, x, self.active.numbers, first]
        wp.launch(corner_forces_kernel, dim=dim, inputs=inputs, outputs=[sums], device=self.device)

    def nearest(self, x, dense: wp.array, at_rest: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Least distance (env,) mm of the shape from the surface, at points with shape functions (point, nodes).

        And the largest overlap (env,) beyond ``at_rest`` mm, over the edge of its own face; 0 without any.
        """
        self._least.fill_(np.inf)
        self._largest.zero_()
        self._launch(nearest_kernel, [x, dense, at_rest, self.active], [self._least, self._largest])
        return tuple(map(np.copy, read(self._least, self._largest)))

    def room(self, x, dense: wp.array, other: Contact) -> np.ndarray:
        """Distance (env,) mm that is left between the shape and that of another contact of the same body, at least.

        Where the surface overlaps the shape, at points with shape functions (point, nodes); negative where the overlap
        is more than the gel that is left, inf where there is none.
        """
        self._least.fill_(np.inf)
        self._launch(room_kernel, [other.surface, x, dense, self.active], [self._least])
        [room] = read(self._least)
        return room.copy()
