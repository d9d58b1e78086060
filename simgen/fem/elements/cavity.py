"""Incompressible fluid in the cavity of a hollow body, as a term of the solver.

The fluid keeps its volume. Its pressure p_c (compression positive, above ambient) is the Lagrange multiplier of this
condition. Let x,1 and x,2 be the derivatives of the position by a wetted face's coordinates. The area vector x,1 x x,2
points out of the solid into the fluid. Per unit of those coordinates ::

    force on the solid      -p_c x,1 x x,2
    V(0) - V(u)             u . (X,1 x X,2 + (X,1 x u,2 + u,1 x X,2) / 2 + u,1 x u,2 / 3)

The second line is the volume that the faces sweep on straight paths. It is exact for any u and independent of the
origin. All other walls of the cavity must sweep no volume: fixed faces, a rigid core, planes of symmetry that contain
the faces' rim. Then the force is the derivative of the volume, and its tangent is symmetric (Bonet and Wood, *Nonlinear
Continuum Mechanics*, 2nd ed., section 8.5; Rumpel and Schweizerhof, Int. J. Numer. Meth. Engng 56, 2003). On quadratic
faces all integrands are polynomials of degree 4, which the six-point rule integrates exactly.

The pressure acts on all wetted faces, also where they touch a core: the model assumes a film of fluid there. There the
contact carries only the pressure above the fluid's.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from simgen.fem import batch_arrays
from simgen.fem.blocks import Blocks, add_block
from simgen.fem.chunks import CHUNK, chunks
from simgen.fem.device import launch_kernel, read
from simgen.fem.elements.element import TRIANGLE_EDGES, Element, face_shapes
from simgen.fem.elements.element_fields import gather
from simgen.fem.precision import mat33f, real, single, vec3

wp.set_module_options({"enable_backward": False})

FACE_POINTS = 6  # exact on quadratic faces


@wp.struct
class Wetted:
    """Wetted faces, oriented outward from the solid, and their quadrature rule."""

    rest: wp.array2d(dtype=wp.float64)  # (3 nodes, 1) rest positions, mm
    faces: wp.array2d(dtype=wp.int32)  # (face, 6)
    shapes: wp.array2d(dtype=wp.float64)  # (q, 6)
    gradients: wp.array2d(dtype=wp.vec2d)  # (q, 6) of the shape functions by the face's coordinates
    weights: wp.array(dtype=wp.float64)  # (q,)
    row: wp.int32  # row of p_c in the state vector and of the volume in the residual


@wp.struct
class Tangents:
    along: vec3  # derivative of a field by a face's first coordinate
    across: vec3  # derivative by the second


@wp.func
def tangents(w: Wetted, field: wp.array2d(dtype=Any), f: wp.int32, q: wp.int32, env: wp.int32) -> Tangents:
    out = Tangents()
    for a in range(w.gradients.shape[1]):
        value = vec3(gather(w.faces, field, f, a, env))
        out.along += w.gradients[q, a][0] * value
        out.across += w.gradients[q, a][1] * value
    return out


@wp.func
def at_point(w: Wetted, field: wp.array2d(dtype=Any), f: wp.int32, q: wp.int32, env: wp.int32) -> vec3:
    value = vec3()
    for a in range(w.shapes.shape[1]):
        value += w.shapes[q, a] * vec3(gather(w.faces, field, f, a, env))
    return value


@wp.func
def add_force(w: Wetted, force: vec3, f: wp.int32, q: wp.int32, env: wp.int32, out: wp.array2d(dtype=Any)):
    for a in range(w.shapes.shape[1]):
        row, share = 3 * w.faces[f, a], w.shapes[q, a] * force
        for i in range(3):
            wp.atomic_add(out, row + i, env, out.dtype(share[i]))


@wp.func
def plus(a: Tangents, b: Tangents) -> Tangents:
    out = Tangents()
    out.along = a.along + b.along
    out.across = a.across + b.across
    return out


@wp.func
def area_vector(x: Tangents) -> vec3:
    return wp.cross(x.along, x.across)


@wp.func
def turned(x: Tangents, dx: Tangents) -> vec3:
    """Derivative of the area vector."""
    return wp.cross(x.along, dx.across) + wp.cross(dx.along, x.across)


@wp.func
def swept(X: Tangents, u: vec3, du: Tangents) -> real:
    """u . integral over s in 0..1 of the area vector at X + s u."""
    return wp.dot(u, area_vector(X) + real(0.5) * turned(X, du) + area_vector(du) / real(3.0))


@wp.kernel
def cavity_residual_kernel(
    w: Wetted,
    x: wp.array2d(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    # outputs
    residual_out: wp.array2d(dtype=wp.float64),
):
    f, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    volume = real(0.0)
    for q in range(w.weights.shape[0]):
        X, du = tangents(w, w.rest, f, q, 0), tangents(w, x, f, q, env)
        volume += w.weights[q] * swept(X, at_point(w, x, f, q, env), du)
        add_force(w, (w.weights[q] * x[w.row, env]) * area_vector(plus(X, du)), f, q, env, residual_out)
    wp.atomic_add(residual_out, w.row, env, volume)


@wp.kernel
def cavity_linearize_kernel(
    w: Wetted,
    x: wp.array2d(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    # outputs
    pressure_out: wp.array(dtype=wp.float64),
    deformed_out: wp.array3d(dtype=Tangents),
    gradient_out: wp.array2d(dtype=wp.float64),
):
    f, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    pressure_out[env] = x[w.row, env]
    for q in range(w.weights.shape[0]):
        now = plus(tangents(w, w.rest, f, q, 0), tangents(w, x, f, q, env))
        deformed_out[f, q, env] = now
        add_force(w, w.weights[q] * area_vector(now), f, q, env, gradient_out)


@wp.kernel
def cavity_action_kernel(
    w: Wetted,
    pressure: wp.array(dtype=wp.float64),
    deformed: wp.array3d(dtype=Tangents),
    v: wp.array2d(dtype=wp.float32),
    active: wp.array(dtype=wp.int32),
    # outputs
    action_out: wp.array2d(dtype=wp.float32),
):
    f, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    volume = real(0.0)
    for q in range(w.weights.shape[0]):
        now = deformed[f, q, env]
        area = area_vector(now)
        volume += w.weights[q] * wp.dot(at_point(w, v, f, q, env), area)
        force = pressure[env] * turned(now, tangents(w, v, f, q, env)) + real(v[w.row, env]) * area
        add_force(w, w.weights[q] * force, f, q, env, action_out)
    wp.atomic_add(action_out, w.row, env, single(volume))


@wp.kernel
def cavity_blocks_kernel(
    w: Wetted,
    pressure: wp.array(dtype=wp.float64),
    deformed: wp.array3d(dtype=Tangents),
    active: wp.array(dtype=wp.int32),
    block_index: wp.array3d(dtype=wp.int32),
    # outputs
    blocks_out: Blocks,
):
    """Add K_ab = p_c N_a skew(N_b,2 x,1 - N_b,1 x,2), the change of the pressure's forces with the faces."""
    f, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    for q in range(w.weights.shape[0]):
        now = deformed[f, q, env]
        for b in range(w.shapes.shape[1]):
            turn = wp.skew(w.gradients[q, b][1] * now.along - w.gradients[q, b][0] * now.across)
            for a in range(w.shapes.shape[1]):
                factor = w.weights[q] * pressure[env] * w.shapes[q, a]
                add_block(blocks_out, block_index[f, a, b], env, mat33f(factor * turn))


@wp.kernel
def add_volume_kernel(volume: wp.array(dtype=wp.float64), row: wp.int32, residual_out: wp.array2d(dtype=wp.float64)):
    env = wp.tid()
    residual_out[row, env] = residual_out[row, env] + volume[env]


@wp.kernel
def resultant_kernel(
    gradient: wp.array2d(dtype=wp.float64),
    pressure: wp.array(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    # outputs
    force_out: wp.array2d(dtype=wp.float64),
):
    """Sum the force on the solid (3, env): minus the pressure times the nodes' gradients."""
    c, i, lane = wp.tid()
    env = active[lane]
    if env < 0:
        return
    total, nodes = real(0.0), gradient.shape[0] // 3
    for node in range(c * CHUNK, wp.min((c + 1) * CHUNK, nodes)):
        total += gradient[3 * node + i, env]
    wp.atomic_add(force_out, i, env, -pressure[env] * total)


class Cavity:
    """Fluid behind the wetted faces (f, 6) of a rest mesh, nodes in mm.

    ``row`` is the row of p_c in the state vector. ``fixed`` (node,) or (node, 3) bool marks fixed components. Raises
    ValueError if the faces leave an opening whose rim is free.

    injected : (env,) mm3, added to the fluid
    volume : mm3, enclosed by the faces at rest. If other walls close the cavity, the volume between the faces and the
        mean of their nodes
    """

    def __init__(self, element: Element, nodes, faces, fixed: np.ndarray, row: int, device, active):
        self.device, self.active, self.row = device, active, row
        n_env = active.shape[0]
        shapes, gradients, weights = face_shapes(element, FACE_POINTS)
        self.host_faces = np.ascontiguousarray(faces[:, : shapes.shape[1]], dtype=np.int32)
        rim = open_rim(self.host_faces)
        stays = fixed if fixed.ndim == 1 else fixed.any(axis=1)
        if not stays[rim].all():
            raise ValueError("the cavity is open: its wetted faces have a rim that is free to move")
        corners = np.asarray(nodes)[self.host_faces]
        position = np.einsum("qa,fai->fqi", shapes, corners) - corners.mean(axis=(0, 1))
        along, across = np.einsum("qaj,fai->jfqi", gradients, corners)
        self.volume = abs(np.einsum("fqi,fqi,q->", position, np.cross(along, across), weights)) / 3.0
        w = self.wetted = Wetted()
        w.rest = wp.array(np.reshape(nodes, (-1, 1)), dtype=wp.float64, device=device)
        w.faces = wp.array(self.host_faces, dtype=wp.int32, device=device)
        w.shapes = wp.array(shapes, dtype=wp.float64, device=device)
        w.gradients = wp.array(gradients, dtype=wp.vec2d, device=device)
        w.weights = wp.array(weights, dtype=wp.float64, device=device)
        w.row = row
        self.injected = wp.zeros(n_env, dtype=wp.float64, device=device)
        self._pressure = wp.zeros(n_env, dtype=wp.float64, device=device)
        self._deformed = wp.zeros((len(faces), len(weights), n_env), dtype=Tangents, device=device)
        self.gradient = wp.zeros((3 * len(nodes), n_env), dtype=wp.float64, device=device)
        self._force = wp.zeros((3, n_env), dtype=wp.float64, device=device)

    def _launch(self, kernel, inputs, outputs):
        batch_arrays.launch(kernel, len(self.host_faces), [self.wetted, *inputs], outputs)

    def residual(self, x, residual_out):
        """Add the forces of p_c, and to its row the missing volume V(0) + injected - V(u), mm3."""
        self._launch(cavity_residual_kernel, [x, self.active], [residual_out])
        inputs, n_env = [self.injected, self.row], len(self.injected)
        launch_kernel(add_volume_kernel, dim=n_env, inputs=inputs, outputs=[residual_out], device=self.device)

    def linearize(self, x):
        """Store the state x for the tangent; ``gradient`` (3 nodes, env) is the derivative of the volume row by u."""
        batch_arrays.clear(self.active, self.gradient)
        self._launch(cavity_linearize_kernel, [x, self.active], [self._pressure, self._deformed, self.gradient])

    def tangent(self, v, action_out):
        """Add the action of the derivative at the state of the last ``linearize``."""
        self._launch(cavity_action_kernel, [self._pressure, self._deformed, v, self.active], [action_out])

    def resultant(self, x) -> np.ndarray:
        """Compute the force (env, 3) on the solid: zero if the wetted faces alone close the cavity."""
        self.linearize(x)
        self._force.zero_()
        rows = chunks(len(self.gradient) // 3), 3
        batch_arrays.launch(resultant_kernel, rows, [self.gradient, self._pressure, self.active], [self._force])
        [force] = read(self._force)
        return force.T.copy()

    def blocks(self, block_index, blocks_out, linear: bool):
        """Add the derivative by displacements as 3 x 3 blocks between nodes. Summed over faces they are symmetric."""
        self._launch(cavity_blocks_kernel, [self._pressure, self._deformed, self.active, block_index], [blocks_out])


def open_rim(faces: np.ndarray) -> np.ndarray:
    """Nodes (n,) of the edges that belong to only one of the faces (f, 6 or 3)."""
    ends = np.sort(faces[:, TRIANGLE_EDGES].reshape(-1, 2), axis=1)
    _, first, count = np.unique(ends, axis=0, return_index=True, return_counts=True)
    face, edge = np.divmod(first[count == 1], 3)
    local = np.column_stack([TRIANGLE_EDGES, [3, 4, 5]])[:, : 3 if faces.shape[1] == 6 else 2]
    return np.unique(faces[face[:, None], local[edge]])
