"""Contact of one surface with one rigid shape per environment, as a term of the solver.

A scene has up to three contacts: of the touchable surface with the indenter, of the inner skin with the core (BioTac),
and of free faces with the support below the gel (DIGIT). An environment is one of the presses that are solved together.
The formulas are in ``traction.py``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import warp as wp

from simgen.fem import batch_arrays
from simgen.fem.blocks import zeros as block_zeros
from simgen.fem.contact.candidates import find_candidates_kernel, no_candidates_kernel
from simgen.fem.contact.forces import (
    contact_action_kernel,
    contact_blocks_kernel,
    contact_diagonal_kernel,
    contact_residual_kernel,
    contact_tangent_kernel,
)
from simgen.fem.contact.multipliers import (
    MAX_IN_INCREMENT,
    MAX_STIFFENING,
    anchor_kernel,
    carry_kernel,
    change_kernel,
    extrapolate_kernel,
    stiffen_kernel,
    update_kernel,
)
from simgen.fem.contact.results import corner_forces_kernel, gap_kernel, nearest_kernel, resultant_kernel, room_kernel
from simgen.fem.contact.traction import Surface
from simgen.fem.device import Reading, launch_kernel, write
from simgen.fem.elements.element import Element, face_geometry
from simgen.fem.precision import mat33, vec3
from simgen.geometry.rigid_shape import shape_array
from simgen.geometry.signed_distance import RigidShape

wp.set_module_options({"enable_backward": False})


class Resultants(NamedTuple):
    """Resultants and penetration of a contact, per environment.

    force : (env, 3) on the sensor, in solver units
    moment : (env, 3) about the origin
    rms_penetration, max_penetration : (env,) mm
    area : (env,) mm2, contact area at rest
    slip_share : (env,) share of the contact area that slides; 0 without contact
    """

    force: np.ndarray
    moment: np.ndarray
    rms_penetration: np.ndarray
    max_penetration: np.ndarray
    area: np.ndarray
    slip_share: np.ndarray

    @classmethod
    def of_sums(cls, force: np.ndarray, moment: np.ndarray, sums: np.ndarray) -> Resultants:
        """Make them of the sums (4, env) of `simgen.fem.contact.results.resultant_kernel`."""
        area, squared, deepest, sliding = sums
        divisor = np.where(area > 0.0, area, 1.0)
        return cls(force, moment, np.sqrt(squared / divisor), np.maximum(deepest, 0.0), area, sliding / divisor)


class Last(NamedTuple):
    """The increment before, from which the next one is predicted.

    x, poses : state and poses of the shapes (env, 4, 4) at its start
    ratio : (env,) length of the next increment over its length; 0 at the start of a path, where the path turns by
        a right angle or more, and after a much shorter increment, which tells little
    """

    x: wp.array
    poses: np.ndarray
    ratio: np.ndarray


class Contact:
    """Contact of a surface with one rigid shape per environment.

    nodes, faces : (n, 3) mm of the mesh at rest, and node numbers (f, 6) of the surface's faces
    stiffness : of the normal traction and of the friction traction; each is a stiffness k as the number k * edge / E
    friction : Coulomb coefficient
    active : list of the environments in which kernels act
    """

    def __init__(self, element: Element, nodes, faces, stiffness: tuple[float, float], friction: float, device, active):
        self.device, self.active, self.friction = device, active, friction
        self.n_env = n_env = len(active)
        geometry = face_geometry(element, nodes, faces)
        faces = np.ascontiguousarray(faces[:, : geometry.shapes.shape[1]], dtype=np.int32)
        corners, slots = np.unique(faces[:, :3], return_inverse=True)
        slots = slots.reshape(-1, 3).astype(np.int32)
        edges = np.sqrt(2.0 * geometry.areas.sum(axis=1))
        areas_of_slots = geometry.areas @ geometry.multiplier_shapes
        # Integrals over the area around each corner: of the edge length (mm3), and of 1 (mm2).
        weights, self.corner_areas = np.zeros((2, len(corners)))
        np.add.at(weights, slots, edges[:, None] * areas_of_slots)
        np.add.at(self.corner_areas, slots, areas_of_slots)
        self.host_faces, self.corners, self.n_slots = faces, corners, len(corners)
        self.edge = float(np.sqrt((edges**2).mean()))  # mm, of a mean face
        self._points = (*geometry.areas.shape, n_env)
        per_face, per_slot = (len(faces), n_env), (self.n_slots, n_env)

        def array(values, dtype=wp.float64):
            return wp.array(values, dtype=dtype, device=device)

        def zeros(shape, dtype=wp.float64):
            return wp.zeros(shape, dtype=dtype, device=device)

        s = self.surface = Surface()
        s.positions, s.edges = array(nodes, vec3), array(edges)
        s.faces, s.slots = array(faces, wp.int32), array(slots, wp.int32)
        s.shapes, s.multiplier_shapes = array(geometry.shapes), array(geometry.multiplier_shapes)
        s.areas, s.gap_offset = array(geometry.areas), zeros(geometry.areas.shape)
        s.shape_of, s.origin = zeros(n_env, wp.int32), zeros(n_env, vec3)
        s.rotation = array(np.tile(np.eye(3), (n_env, 1, 1)), mat33)
        s.anchor, self._carried = zeros(self._points, vec3), zeros(self._points, vec3)
        s.normal, s.tangential = zeros(per_slot), zeros(per_slot, vec3)
        s.candidates = array(np.tile(np.arange(len(faces))[:, None], n_env), wp.int32)
        s.count = wp.full(n_env, len(faces), dtype=wp.int32, device=device)
        s.stiffening = wp.ones(per_face, dtype=wp.float64, device=device)
        s.stiffness, s.friction_stiffness = stiffness
        s.friction = friction

        self.weights = array(weights)
        self._is_candidate, self._touching = zeros(per_face, wp.int32), zeros(per_face, wp.int32)
        self._travel = zeros(n_env)
        self._stiffening = wp.ones_like(s.stiffening)  # of the next increment
        self._tangent = block_zeros(geometry.areas.size, n_env, device)  # at the points of candidates
        self._sums, self._change = zeros(per_slot, wp.vec4d), zeros((2, n_env))
        self._resultants = [zeros(n_env, vec3), zeros(n_env, vec3), zeros((4, n_env))]
        self._least, self._largest, self._room = zeros(n_env), zeros(n_env), zeros(n_env)
        self._start_rotation, self._start_origin = wp.zeros_like(s.rotation), wp.zeros_like(s.origin)
        self._in_contact = zeros((1, n_env), wp.int32)
        self._last_rotation, self._last_origin = wp.zeros_like(s.rotation), wp.zeros_like(s.origin)
        anchor = s.anchor.reshape((-1, n_env))
        self._history = s.normal, s.tangential, anchor, s.stiffening, self._is_candidate
        self._saved = [wp.zeros_like(array) for array in self._history]
        self._before = wp.zeros_like(s.normal), wp.zeros_like(s.tangential)  # at the last converged increment's start
        one_each = [each.reshape((1, n_env)) for each in (s.shape_of, s.origin, s.rotation, s.count)]
        # All that a contact keeps of a press between two linear systems, (row, env)
        self.memory = [*self._history, *self._saved, *self._before, s.candidates, *one_each]

    def _launch(self, kernel, inputs, outputs, rows: int | tuple[int, ...] = 0):
        batch_arrays.launch(kernel, rows or len(self.host_faces), [self.surface, *inputs], outputs)

    def set_shapes(self, shapes: list[RigidShape], touching_state: wp.array | None = None):
        """Set the rigid shapes, and forget all tractions.

        With as many shapes as environments, each environment has its own. Otherwise all have the first one, until
        :meth:`choose`.

        Where the surface overlaps the shape in ``touching_state``, the gap there counts as 0: at rest a skin may lie on
        its core to within the accuracy of both meshes.
        """
        s = self.surface
        s.rigid = shape_array(shapes, self.device)
        self.choose(np.arange(self.n_env) if len(shapes) == self.n_env else np.zeros(self.n_env))
        s.normal.zero_()
        s.tangential.zero_()
        self._is_candidate.zero_()
        s.gap_offset.zero_()
        if touching_state is not None:
            overlap = np.maximum(-self.gap(touching_state)[:, :, 0], 0.0)
            s.gap_offset = wp.array(overlap, dtype=wp.float64, device=self.device)

    def choose(self, shape_of: np.ndarray):
        """Choose one of the shapes, by its number, for each environment (env,)."""
        write(shape_of.astype(np.int32), self.surface.shape_of)

    def forget(self, marked):
        """Drop the tractions of the listed environments."""
        for array in (self.surface.normal, self.surface.tangential, self._is_candidate, *self._before):
            batch_arrays.clear(marked, array)

    def set_pose(self, poses: np.ndarray):
        """Place the shapes: (env, 4, 4), shape frame -> sensor frame, mm."""
        write(poses[:, :3, :3], self.surface.rotation)
        write(poses[:, :3, 3], self.surface.origin)

    def gap(self, x) -> np.ndarray:
        """Signed distance of the shape at all quadrature points, (face, q, env) mm."""
        gap = wp.zeros(self._points, dtype=wp.float64, device=self.device)
        self._launch(gap_kernel, [x, self.active], [gap], self._points[:2])
        return gap.numpy()

    def begin_increment(self, x_start, x_predicted, start_poses, poses, travel: np.ndarray, last: Last | None = None):
        """Start an increment of the active environments at ``x_start`` and ``start_poses``, and save the tractions.

        Faces that cannot touch if points end at most ``travel`` (env,) mm from ``x_predicted`` are left out. Where a
        point enters contact, its slip counts from its entry on the way from ``x_start`` to ``x_predicted``. The shapes
        move to ``poses`` in all environments.
        """
        for array, saved in zip(self._history, self._saved, strict=True):
            batch_arrays.copy(array, self.active, saved)
        self.set_pose(poses)
        self._find_candidates(x_predicted, travel)  # and all faces with a positive multiplier
        self.set_pose(start_poses)
        self._launch(stiffen_kernel, [x_start, MAX_STIFFENING, self.active], [self._stiffening])
        if self.friction > 0.0:
            wp.copy(self._start_rotation, self.surface.rotation)
            wp.copy(self._start_origin, self.surface.origin)
            inputs = [x_start, self._saved[-1], self._stiffening, self.active]
            batch_arrays.clear(self.active, self._in_contact)
            self._launch(carry_kernel, inputs, [self._carried, self._in_contact])
        self.set_pose(poses)
        if self.friction > 0.0:
            last = last or Last(x_start, start_poses, np.zeros(self.n_env))
            write(last.poses[:, :3, :3], self._last_rotation)
            write(last.poses[:, :3, 3], self._last_origin)
            poses = [self._last_rotation, self._last_origin, self._start_rotation, self._start_origin]
            ratio = self.active.factors(last.ratio)
            inputs = [last.x, x_start, x_predicted, *poses, ratio, self._carried, self._in_contact, self.active]
            self._launch(anchor_kernel, inputs, [self.surface.anchor])
        batch_arrays.copy(self._stiffening, self.active, self.surface.stiffening)

    def stiffen(self, x):
        """Raise the stiffness of faces that overlap the shape too deeply at x, within an increment."""
        batch_arrays.copy(self.surface.stiffening, self.active, self._stiffening)
        self._launch(stiffen_kernel, [x, MAX_IN_INCREMENT, self.active], [self._stiffening])
        batch_arrays.copy(self._stiffening, self.active, self.surface.stiffening)

    def extrapolate(self, factor: np.ndarray):
        """Extrapolate the active environments' multipliers by ``factor`` (env,) times the last increment's change."""
        inputs = [*self._before, self.active.factors(factor), self.active]
        self._launch(extrapolate_kernel, inputs, [], self.n_slots)

    def keep(self, marked):
        """Mark the increments of the listed environments as converged: :meth:`extrapolate` continues them."""
        for saved, before in zip(self._saved[:2], self._before, strict=True):
            batch_arrays.copy(saved, marked, before)

    def _find_candidates(self, x, travel: np.ndarray):
        """List the faces that can touch if points end at most ``travel`` (env,) mm from x."""
        s = self.surface
        write(travel, self._travel)
        batch_arrays.launch(no_candidates_kernel, (), [self.active], [s.count])
        outputs = [s.count, s.candidates, self._is_candidate]
        self._launch(find_candidates_kernel, [x, self._travel, self.active], outputs)

    def restore(self, marked):
        """Return the listed environments to the start of their increment."""
        for array, saved in zip(self._history, self._saved, strict=True):
            batch_arrays.copy(saved, marked, array)

    def residual(self, x, residual_out):
        """Add the forces at x, and integrate tractions minus multipliers around each corner, for an update."""
        self._sums.zero_()
        self._launch(contact_residual_kernel, [x, self.active], [residual_out, self._sums])

    def multiplier_change(self) -> wp.array:
        """Squared L2 norms (2, env) on the device, weighted by edge length, at the state of the last ``residual``.

        Row 0 has the change that an update would make, row 1 the updated normal multipliers.
        """
        self._change.zero_()
        inputs = [self.weights, self._sums, self.active]
        self._launch(change_kernel, inputs, [self._change], self.n_slots)
        return self._change

    def update_multipliers(self):
        """Project the tractions of the last ``residual`` onto the multipliers."""
        self._launch(update_kernel, [self.weights, self._sums, self.active], [], self.n_slots)

    def linearize(self, x):
        """Store the tangent at state x."""
        self._launch(contact_tangent_kernel, [x, self.active], [self._tangent, self._touching])

    def tangent(self, v, action_out):
        """Add the derivative's action on v at the state of the last ``linearize``."""
        self._launch(contact_action_kernel, [self._tangent, self._touching, v, self.active], [action_out])

    def blocks(self, block_index, blocks_out, linear: bool):
        """Add the derivative as 3 x 3 blocks between nodes, or between corners for linear displacements."""
        shapes = self.surface.multiplier_shapes if linear else self.surface.shapes
        inputs = [self._tangent, self._touching, shapes, self.active, block_index]
        self._launch(contact_blocks_kernel, inputs, [blocks_out])

    def diagonal(self, diagonal_out):
        """Add the 3 x 3 diagonal blocks of the nodes."""
        self._launch(contact_diagonal_kernel, [self._tangent, self._touching, self.active], [diagonal_out])

    def resultants(self, x) -> Reading:
        """Measure the contact at state x: a reading of `Resultants`."""
        for array in self._resultants:
            array.zero_()
        self._launch(resultant_kernel, [x, self.active], self._resultants)
        return Reading(tuple(self._resultants), Resultants.of_sums)

    def add_corner_forces(self, sums: wp.array, x, first: int = 0):
        """Distribute the forces on the sensor at state x to `corners`, and add them to sums (corner, 3, lane).

        Divided by `corner_areas` they are tractions per rest area. Lane j is the active environment ``first + j``.
        """
        dim, inputs = (len(self.host_faces), sums.shape[2]), [self.surface, x, self.active.numbers, first]
        launch_kernel(corner_forces_kernel, dim=dim, inputs=inputs, outputs=[sums], device=self.device)

    def nearest(self, x, dense: wp.array, at_rest: float = 0.0) -> Reading:
        """Measure the least distance (env,) mm of the shape from the surface, at points ``dense`` (point, node).

        The second part of the reading is the largest overlap (env,) beyond ``at_rest`` mm, as a share of its face's
        edge; 0 without overlap. Points are given by their shape functions.
        """
        self._least.fill_(np.inf)
        self._largest.zero_()
        self._launch(nearest_kernel, [x, dense, at_rest, self.active], [self._least, self._largest])
        return Reading((self._least, self._largest), lambda *both: both)

    def room(self, x, dense: wp.array, other: Contact) -> Reading:
        """Measure the least thickness (env,) mm of gel that is left between this contact's shape and another's.

        At points that overlap this shape, it is the distance from the other shape minus the overlap: negative where the
        shapes meet. It is inf without overlap. Points have the shape functions ``dense`` (point, node).
        """
        self._room.fill_(np.inf)
        self._launch(room_kernel, [other.surface, x, dense, self.active], [self._room])
        return Reading((self._room,), lambda room: room)
