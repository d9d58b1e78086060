"""Contact of one surface with one rigid shape per environment, as a term of the solver.

The formulas are in ``traction.py``; the kernels here gather and scatter. Used twice: the touchable surface against the
indenter, and the BioTac's inner skin against its core.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from ..distance import RigidShape, probe
from ..shape import shape_array
from .element import Element, face_geometry
from .element_fields import gather, scatter
from .krylov import copy_environments
from .material import mat33, mat33f, real, single, vec3, vec3f
from .operator import add_vec3
from .traction import Surface, deformed, probe_in_sensor_frame, return_to_cone, traction

wp.set_module_options({"enable_backward": False})


@wp.kernel
def contact_residual_kernel(
    s: Surface,
    x: wp.array2d(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    # outputs
    residual_out: wp.array2d(dtype=wp.float64),
):
    f, env = wp.tid()
    if active[env] == 0:
        return
    for q in range(s.areas.shape[1]):
        found = traction(s, x, f, q, env)
        if found.pressure > real(0.0):
            force = s.areas[f, q] * (found.pressure * found.normal + found.friction)
            for a in range(s.shapes.shape[1]):
                add_vec3(residual_out, s.faces[f, a], env, -s.shapes[q, a] * force)


@wp.kernel
def contact_tangent_kernel(
    s: Surface,
    x: wp.array2d(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    # outputs
    tangent_out: wp.array3d(dtype=mat33f),
):
    """Store the tangent at every quadrature point: it is used for many Krylov iterations."""
    f, env = wp.tid()
    if active[env] == 0:
        return
    for q in range(s.areas.shape[1]):
        found = traction(s, x, f, q, env)
        tangent_out[f, q, env] = mat33f(s.areas[f, q] * found.tangent)


@wp.func
def touches(K: mat33f) -> wp.bool:
    """Whether there is contact at a point, from its tangent."""
    return K[0, 0] != 0.0 or K[1, 1] != 0.0 or K[2, 2] != 0.0


@wp.kernel
def contact_action_kernel(
    s: Surface,
    tangent: wp.array3d(dtype=mat33f),
    v: wp.array2d(dtype=wp.float32),
    active: wp.array(dtype=wp.int32),
    # outputs
    action_out: wp.array2d(dtype=wp.float32),
):
    f, env = wp.tid()
    if active[env] == 0:
        return
    for q in range(s.areas.shape[1]):
        K = tangent[f, q, env]
        if touches(K):
            dx = vec3f()
            for a in range(s.shapes.shape[1]):
                dx += single(s.shapes[q, a]) * gather(s.faces, v, f, a, env)
            df = K * dx
            for a in range(s.shapes.shape[1]):
                scatter(s.faces, single(s.shapes[q, a]) * df, f, a, env, action_out)


@wp.kernel
def contact_blocks_kernel(
    s: Surface,
    tangent: wp.array3d(dtype=mat33f),
    shapes: wp.array2d(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    block_index: wp.array3d(dtype=wp.int32),
    # outputs
    blocks_out: wp.array2d(dtype=mat33f),
):
    f, env = wp.tid()
    if active[env] == 0:
        return
    for q in range(s.areas.shape[1]):
        K = tangent[f, q, env]
        if touches(K):
            for a in range(shapes.shape[1]):
                for b in range(shapes.shape[1]):
                    weight = single(shapes[q, a] * shapes[q, b])
                    wp.atomic_add(blocks_out, block_index[f, a, b], env, weight * K)


@wp.kernel
def contact_diagonal_kernel(
    s: Surface,
    tangent: wp.array3d(dtype=mat33f),
    active: wp.array(dtype=wp.int32),
    # outputs
    diagonal_out: wp.array2d(dtype=mat33f),
):
    f, env = wp.tid()
    if active[env] == 0:
        return
    for q in range(s.areas.shape[1]):
        K = tangent[f, q, env]
        if touches(K):
            for a in range(s.shapes.shape[1]):
                wp.atomic_add(diagonal_out, s.faces[f, a], env, single(s.shapes[q, a] * s.shapes[q, a]) * K)


@wp.kernel
def gap_kernel(
    s: Surface,
    x: wp.array2d(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    # outputs
    gap_out: wp.array3d(dtype=wp.float64),
):
    f, q, env = wp.tid()
    if active[env] == 0:
        return
    gap_out[f, q, env] = probe_in_sensor_frame(s, deformed(s, x, f, q, env), f, q, env).distance


@wp.kernel
def anchor_kernel(
    s: Surface,
    x_start: wp.array2d(dtype=wp.float64),
    x_predicted: wp.array2d(dtype=wp.float64),
    rotation_start: wp.array(dtype=mat33),
    origin_start: wp.array(dtype=vec3),
    carried: wp.array3d(dtype=vec3),
    active: wp.array(dtype=wp.int32),
    # outputs
    anchor_out: wp.array3d(dtype=vec3),
):
    """Where slip begins to count, in the shape's frame.

    A point in contact: behind the start by the slip that it carries. Else on the straight path to the predicted state:
    where a point that is apart by g0 and would overlap by -g1 enters, or at the path's end if it is not to enter.
    """
    f, q, env = wp.tid()
    if active[env] == 0:
        return
    start = wp.transpose(rotation_start[env]) * (deformed(s, x_start, f, q, env) - origin_start[env])
    predicted = wp.transpose(s.rotation[env]) * (deformed(s, x_predicted, f, q, env) - s.origin[env])
    g0 = probe(s.rigid[env], start).distance + s.gap_offset[f, q]
    g1 = wp.min(probe(s.rigid[env], predicted).distance + s.gap_offset[f, q], real(0.0))
    entry = real(0.0)
    if g0 > real(0.0) and wp.length_sq(carried[f, q, env]) == real(0.0):
        entry = g0 / (g0 - g1)
    anchor_out[f, q, env] = start + entry * (predicted - start) - carried[f, q, env]


@wp.kernel
def carry_kernel(
    s: Surface,
    x: wp.array2d(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    # outputs
    carried_out: wp.array3d(dtype=vec3),
):
    """The slip, in the shape's frame, that makes the next increment begin with the friction traction of this state.

    The multipliers meet the tractions only on average around a corner. Were slip counted anew at every increment, what
    differs at a point would be forgotten, and a contact that sticks would creep with the number of increments.
    """
    f, q, env = wp.tid()
    if active[env] == 0:
        return
    found = traction(s, x, f, q, env)
    k_inverse = s.edges[f] / s.friction_stiffness
    slip = vec3()
    if found.pressure > real(0.0) and found.multiplier > real(0.0):  # without it the anchor may be from another press
        slip = wp.transpose(s.rotation[env]) * ((found.tangential - found.friction) * k_inverse)
    carried_out[f, q, env] = slip


@wp.kernel
def project_kernel(
    s: Surface,
    x: wp.array2d(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    # outputs
    normal_out: wp.array2d(dtype=wp.float64),
    tangential_out: wp.array2d(dtype=vec3),
):
    """Integrate edge (t - lambda) and edge (tau - lambda_t) against the multiplier shape functions."""
    f, env = wp.tid()
    if active[env] == 0:
        return
    for q in range(s.areas.shape[1]):
        found = traction(s, x, f, q, env)
        if found.pressure > real(0.0) or found.multiplier > real(0.0):
            for i in range(3):
                weight = s.edges[f] * s.areas[f, q] * s.multiplier_shapes[q, i]
                wp.atomic_add(normal_out, s.slots[f, i], env, weight * (found.pressure - found.multiplier))
                wp.atomic_add(tangential_out, s.slots[f, i], env, weight * (found.friction - found.tangential))


@wp.kernel
def update_kernel(
    s: Surface,
    weights: wp.array(dtype=wp.float64),
    normal_sum: wp.array2d(dtype=wp.float64),
    tangential_sum: wp.array2d(dtype=vec3),
    active: wp.array(dtype=wp.int32),
    write: wp.int32,
    # outputs
    change_out: wp.array2d(dtype=wp.float64),
):
    """Move the multipliers; sum squared change and squared size of them per environment (lumped, area times edge)."""
    slot, env = wp.tid()
    if active[env] == 0:
        return
    w = weights[slot]
    normal = wp.max(s.normal[slot, env] + normal_sum[slot, env] / w, real(0.0))
    tangential = return_to_cone(s.tangential[slot, env] + tangential_sum[slot, env] / w, s.friction * normal)
    dn = normal - s.normal[slot, env]
    dt = tangential - s.tangential[slot, env]
    wp.atomic_add(change_out, 0, env, w * (dn * dn + wp.dot(dt, dt)))
    wp.atomic_add(change_out, 1, env, w * normal * normal)
    if write == 1:
        s.normal[slot, env] = normal
        s.tangential[slot, env] = tangential


@wp.kernel
def resultant_kernel(
    s: Surface,
    x: wp.array2d(dtype=wp.float64),
    # outputs
    force_out: wp.array(dtype=vec3),
    moment_out: wp.array(dtype=vec3),
    penetration_out: wp.array2d(dtype=wp.float64),
):
    """Force and moment on the sensor; rows of ``penetration_out``: area in contact, integral of g^2 there, max -g."""
    f, env = wp.tid()
    for q in range(s.areas.shape[1]):
        found = traction(s, x, f, q, env)
        if found.pressure > real(0.0):
            area = s.areas[f, q]
            force = area * (found.pressure * found.normal + found.friction)
            wp.atomic_add(force_out, env, force)
            wp.atomic_add(moment_out, env, wp.cross(found.position, force))
            wp.atomic_add(penetration_out, 0, env, area)
            wp.atomic_add(penetration_out, 1, env, area * found.gap * found.gap)
            wp.atomic_max(penetration_out, 2, env, -found.gap)


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
        s.rotation = wp.array(np.tile(np.eye(3), (self.n_env, 1, 1)), dtype=mat33, device=device)
        s.origin = wp.zeros(self.n_env, dtype=vec3, device=device)
        self._points = (*geometry.areas.shape, self.n_env)
        s.anchor = wp.zeros(self._points, dtype=vec3, device=device)
        s.normal = wp.zeros((self.n_slots, self.n_env), dtype=wp.float64, device=device)
        s.tangential = wp.zeros((self.n_slots, self.n_env), dtype=vec3, device=device)
        s.stiffness, s.friction_stiffness = stiffness
        s.friction = friction

        self._tangent = wp.zeros(self._points, dtype=mat33f, device=device)
        self._normal_sum, self._tangential_sum = wp.zeros_like(s.normal), wp.zeros_like(s.tangential)

    def _launch(self, kernel, inputs, outputs, dim=None):
        dim = (len(self.host_faces), self.n_env) if dim is None else dim
        wp.launch(kernel, dim=dim, inputs=[self.surface, *inputs], outputs=outputs, device=self.device)

    def set_shapes(self, shapes: list[RigidShape], count_overlap_as_touching: wp.array | None = None):
        """Give each environment its rigid shape and forget all tractions.

        With ``count_overlap_as_touching`` (a state), points that overlap the shape there have their gap counted from
        there: at rest a skin may lie on its core to within the accuracy of both meshes.
        """
        s = self.surface
        s.rigid = shape_array(shapes, self.device)
        s.normal.zero_()
        s.tangential.zero_()
        s.gap_offset.zero_()
        if count_overlap_as_touching is not None:
            overlap = np.maximum(-self.gap(count_overlap_as_touching)[:, :, 0], 0.0)
            s.gap_offset = wp.array(overlap, dtype=wp.float64, device=self.device)

    def set_pose(self, poses: np.ndarray):
        """Place the shapes: (env, 4, 4), shape frame -> sensor frame, mm."""
        self.surface.rotation.assign(np.ascontiguousarray(poses[:, :3, :3]))
        self.surface.origin.assign(np.ascontiguousarray(poses[:, :3, 3]))

    def gap(self, x) -> np.ndarray:
        """Signed distance at all quadrature points: (face, q, env), mm."""
        gap = wp.zeros(self._points, dtype=wp.float64, device=self.device)
        self._launch(gap_kernel, [x, self.active], [gap], dim=self._points)
        return gap.numpy()

    def begin_increment(self, x_start, x_predicted, start_poses, poses):
        """Start an increment at ``x_start`` and ``start_poses``; the prediction tells where points enter contact."""
        if self.friction > 0.0:
            self.set_pose(start_poses)
            carried = wp.zeros(self._points, dtype=vec3, device=self.device)
            self._launch(carry_kernel, [x_start, self.active], [carried], dim=self._points)
        self.set_pose(poses)
        if self.friction > 0.0:
            rotation = wp.array(np.ascontiguousarray(start_poses[:, :3, :3]), dtype=mat33, device=self.device)
            origin = wp.array(np.ascontiguousarray(start_poses[:, :3, 3]), dtype=vec3, device=self.device)
            inputs = [x_start, x_predicted, rotation, origin, carried, self.active]
            self._launch(anchor_kernel, inputs, [self.surface.anchor], dim=self._points)

    def residual(self, x, residual_out):
        self._launch(contact_residual_kernel, [x, self.active], [residual_out])

    def linearize(self, x):
        self._tangent.zero_()
        self._launch(contact_tangent_kernel, [x, self.active], [self._tangent])

    def tangent(self, v, action_out):
        """Action of the derivative at the state of the last ``linearize``."""
        self._launch(contact_action_kernel, [self._tangent, v, self.active], [action_out])

    def blocks(self, block_index, blocks_out, linear: bool):
        """Add the derivative by displacements, or by linear ones alone, as 3 x 3 blocks between nodes or corners."""
        shapes = self.surface.multiplier_shapes if linear else self.surface.shapes
        self._launch(contact_blocks_kernel, [self._tangent, shapes, self.active, block_index], [blocks_out])

    def diagonal(self, diagonal_out):
        """Add the 3 x 3 blocks of each node's displacement by itself."""
        self._launch(contact_diagonal_kernel, [self._tangent, self.active], [diagonal_out])

    def update_multipliers(self, x, write: bool) -> tuple[np.ndarray, np.ndarray]:
        """Project the tractions onto the multipliers; returns L2 norms (env,) of their change and of themselves."""
        self._normal_sum.zero_()
        self._tangential_sum.zero_()
        self._launch(project_kernel, [x, self.active], [self._normal_sum, self._tangential_sum])
        change = wp.zeros((2, self.n_env), dtype=wp.float64, device=self.device)
        inputs = [self.weights, self._normal_sum, self._tangential_sum, self.active, int(write)]
        self._launch(update_kernel, inputs, [change], dim=(self.n_slots, self.n_env))
        return tuple(np.sqrt(change.numpy() / self.edge))

    def save(self):
        """Tractions and anchors, to be given to :meth:`restore`."""
        return [wp.clone(array) for array in self._history()]

    def _history(self):
        s = self.surface
        return s.normal, s.tangential, s.anchor.reshape((-1, self.n_env))

    def restore(self, saved, environments: np.ndarray):
        """Return the marked environments (env,) bool to saved tractions and anchors."""
        for array, before in zip(self._history(), saved, strict=True):
            copy_environments(before, environments, array)

    def resultants(self, x):
        """On the sensor: force (env, 3), moment about the origin (env, 3), and penetration rms, max (env,) mm."""
        force = wp.zeros(self.n_env, dtype=vec3, device=self.device)
        moment = wp.zeros(self.n_env, dtype=vec3, device=self.device)
        penetration = wp.zeros((3, self.n_env), dtype=wp.float64, device=self.device)
        self._launch(resultant_kernel, [x], [force, moment, penetration])
        area, squared, deepest = penetration.numpy()
        rms = np.sqrt(squared / np.where(area > 0.0, area, 1.0))
        return force.numpy(), moment.numpy(), rms, np.maximum(deepest, 0.0)
