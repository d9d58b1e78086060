"""Contact and Coulomb friction of a deformable surface with a rigid shape, by an augmented Lagrangian.

Normal traction at a surface point: ``t = max(0, lambda - k g)``. Friction traction: ``tau`` = the tangential part of
``lambda_t - k s``, returned to the cone ``|tau| <= friction t`` (Alart and Curnier, Comput. Methods Appl. Mech. Engrg
92, 1991). ``s`` is the slip since the start of the increment, or since the point's entry into contact if that came
later.

k is a number times E over the face's edge, so that meshes of any size, and their fine and coarse faces, hold the
indenter equally well (as in Nitsche's method: Chouly and Hild, SIAM J. Numer. Anal. 51, 2013). Where the pressure
exceeds E, k grows with it (see ``stiffen_kernel``): under fillets pressures reach 9 E, and with the same k for all
faces the surface overlaps the indenter there by half a face.

Multipliers are linear on each face (one per corner) and contact is integrated over the quadratic faces at 12 points:
with one multiplier per quadratic node they oscillate against incompressibility. An update moves each multiplier by the
mean of t - lambda (and tau - lambda_t) around its corner, weighted by area / k, as stationarity of the Lagrangian
requires. Its fixed point is the projection of the tractions. The difference that remains at a point is carried as slip
into the next increment (``contact.py``): otherwise a sticking contact creeps with every increment.

The cone uses t itself, so that Coulomb's law holds at every point of any mesh. Its derivative by the gap makes the
tangent of sliding points unsymmetric. A cone of the lagged lambda is symmetric, but where a patch is as large as a
face, lambda and t differ from point to point: a sphere dragged across a coarse mesh lost a third of its friction.
"""

from __future__ import annotations

import warp as wp

from simgen.fem.batch_arrays import Vectors
from simgen.fem.elements.element_fields import gather
from simgen.fem.precision import mat33, real, vec3
from simgen.geometry.signed_distance import Probe, RigidShape, distance, probe

wp.set_module_options({"enable_backward": False})


FACE_NODES = 6  # at most
# An exact distance has slope 1. A sampled one has slopes of up to 1.27 along an axis at kinks. Beyond its grid the
# distance to the grid is added, at a right angle: up to 1.62.
STEEPEST_SLOPE = wp.constant(wp.float64(1.65))
face_vectors = wp.types.matrix(shape=(FACE_NODES, 3), dtype=wp.float64)  # one for each node


@wp.struct
class Surface:
    """Faces of one contact, its rigid shapes and their poses, and its history, per environment."""

    positions: wp.array(dtype=vec3)  # (node,) rest positions, mm
    faces: wp.array2d(dtype=wp.int32)  # (face, 6)
    slots: wp.array2d(dtype=wp.int32)  # (face, 3) multiplier of each corner
    shapes: wp.array2d(dtype=wp.float64)  # (q, 6)
    multiplier_shapes: wp.array2d(dtype=wp.float64)  # (q, 3)
    areas: wp.array2d(dtype=wp.float64)  # (face, q) mm2
    gap_offset: wp.array2d(dtype=wp.float64)  # (face, q) mm, rest overlap that counts as touching
    rigid: wp.array(dtype=RigidShape)  # (shape,)
    shape_of: wp.array(dtype=wp.int32)  # (env,)
    rotation: wp.array(dtype=mat33)  # (env,) shape frame -> sensor frame
    origin: wp.array(dtype=vec3)  # (env,) mm
    anchor: wp.array3d(dtype=vec3)  # (face, q, env) mm, shape frame: point from which slip counts
    normal: wp.array2d(dtype=wp.float64)  # (slot, env) lambda
    tangential: wp.array2d(dtype=vec3)  # (slot, env) lambda_t
    edges: wp.array(dtype=wp.float64)  # (face,) mm: an edge of a triangle of the face's area
    candidates: wp.array2d(dtype=wp.int32)  # (k, env) faces that can touch in this increment
    count: wp.array(dtype=wp.int32)  # (env,) candidates
    stiffening: wp.array2d(dtype=wp.float64)  # (face, env) factor on both stiffnesses in this increment
    stiffness: wp.float64  # k times edge, of the normal traction
    friction_stiffness: wp.float64  # k times edge, of the friction traction
    friction: wp.float64


@wp.struct
class Traction:
    position: vec3  # mm
    gap: wp.float64  # mm
    normal: vec3
    pressure: wp.float64  # t
    friction: vec3  # tau
    multiplier: wp.float64  # lambda here
    tangential: vec3  # lambda_t here
    tangent: mat33  # minus the derivative of the whole traction by the position


@wp.func
def candidate_face(s: Surface, k: wp.int32, env: wp.int32) -> wp.int32:
    """Face of an environment's candidate k, or -1 if there is no such candidate or environment (env < 0)."""
    if env < 0:
        return -1
    if k >= s.count[env]:
        return -1
    return s.candidates[k, env]


@wp.func
def face_positions(s: Surface, x: Vectors, f: wp.int32, env: wp.int32) -> face_vectors:
    """Deformed positions of the face's six nodes, (6, 3) mm; load them once per face."""
    positions = face_vectors()
    for a in range(FACE_NODES):
        if a < s.shapes.shape[1]:
            positions[a] = s.positions[s.faces[f, a]] + gather(s.faces, x, f, a, env)
    return positions


@wp.func
def face_point(nodes: face_vectors, shapes: wp.array2d(dtype=wp.float64), q: wp.int32) -> vec3:
    """Position of point q on a face, from its nodes and their shape functions (point, node)."""
    position = vec3()
    for a in range(FACE_NODES):
        if a < shapes.shape[1]:
            position += shapes[q, a] * nodes[a]
    return position


@wp.func
def to_shape_frame(s: Surface, position: vec3, env: wp.int32) -> vec3:
    return wp.transpose(s.rotation[env]) * (position - s.origin[env])


@wp.func
def shape_distance(s: Surface, position: vec3, env: wp.int32) -> real:
    """Signed distance of the environment's shape from a position in the sensor's frame, mm."""
    return distance(s.rigid[s.shape_of[env]], to_shape_frame(s, position, env))


@wp.func
def gap_lower_bound(s: Surface, nodes: face_vectors, env: wp.int32) -> real:
    """A lower bound of the shape's distance from a whole face, mm, by the distance from its middle and its slope.

    A quadratic face lies in the convex hull of its Bezier points: its corners and, for each edge ab with the middle
    node m, 2 m - (a + b) / 2.
    """
    middle = (nodes[0] + nodes[1] + nodes[2]) / real(3.0)
    radius = real(0.0)
    for a in range(3):
        radius = wp.max(radius, wp.length(nodes[a] - middle))
        if s.shapes.shape[1] == FACE_NODES:
            control = real(2.0) * nodes[3 + a] - real(0.5) * (nodes[a] + nodes[(a + 1) % 3])
            radius = wp.max(radius, wp.length(control - middle))
    return shape_distance(s, middle, env) - STEEPEST_SLOPE * radius


@wp.func
def gap_at(s: Surface, position: vec3, f: wp.int32, q: wp.int32, env: wp.int32) -> real:
    return shape_distance(s, position, env) + s.gap_offset[f, q]


@wp.func
def probe_in_sensor_frame(s: Surface, position: vec3, f: wp.int32, q: wp.int32, env: wp.int32) -> Probe:
    R = s.rotation[env]
    found = probe(s.rigid[s.shape_of[env]], to_shape_frame(s, position, env))
    found.distance = found.distance + s.gap_offset[f, q]
    found.normal = R * found.normal
    found.curvature = R * found.curvature * wp.transpose(R)
    return found


@wp.func
def return_to_cone(trial: vec3, radius: real) -> vec3:
    size = wp.length(trial)
    if size <= radius:
        return trial
    return trial * (radius / size)


@wp.func
def return_tangent(trial: vec3, radius: real, plane: mat33) -> mat33:
    """Derivative of :func:`return_to_cone` within the tangent plane; the plane's projector where it sticks."""
    size = wp.length(trial)
    if size <= radius:
        return plane
    direction = trial / size
    return (radius / size) * (plane - wp.outer(direction, direction))


@wp.func
def traction_at(s: Surface, position: vec3, f: wp.int32, q: wp.int32, env: wp.int32) -> Traction:
    out = Traction()
    out.position = position
    out.gap = gap_at(s, position, f, q, env)
    for i in range(3):
        out.multiplier += s.multiplier_shapes[q, i] * s.normal[s.slots[f, i], env]
        out.tangential += s.multiplier_shapes[q, i] * s.tangential[s.slots[f, i], env]
    normal_k = s.stiffening[f, env] * s.stiffness / s.edges[f]
    out.pressure = out.multiplier - normal_k * out.gap
    if out.pressure <= real(0.0):
        out.pressure = real(0.0)
        return out
    found = probe_in_sensor_frame(s, position, f, q, env)  # most points end above, without normal and curvature
    out.normal = found.normal
    out.tangent = normal_k * wp.outer(out.normal, out.normal) - out.pressure * found.curvature
    if s.friction > real(0.0):
        slip = out.position - (s.origin[env] + s.rotation[env] * s.anchor[f, q, env])
        k = s.stiffening[f, env] * s.friction_stiffness / s.edges[f]
        plane = wp.identity(n=3, dtype=wp.float64) - wp.outer(out.normal, out.normal)
        trial = plane * (out.tangential - k * slip)
        radius = s.friction * out.pressure
        out.friction = return_to_cone(trial, radius)
        out.tangent += k * return_tangent(trial, radius, plane)
        if wp.length(trial) > radius:
            out.tangent += s.friction * normal_k * wp.outer(wp.normalize(trial), out.normal)
    return out
