"""Cases of the elastic operator alone: frame indifference, Hooke's law, a consistent tangent.

Lengths in mm, stresses in units of Young's modulus (E = 1).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import warp as wp

from simgen.config.solver_settings import SolverSettings
from simgen.fem.batch_arrays import ActiveEnvironments
from simgen.fem.contact.contact import Contact
from simgen.fem.elements.elasticity import Elasticity
from simgen.fem.elements.element import P2P1, tet_geometry
from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from simgen.verification.validate.case import Context, Curve, Outcome, Row, case
from simgen.verification.validate.equilibrium import make_body
from simgen.verification.validate.exact import block, pull
from simgen.verification.validate.meshes import Mesh, top
from simgen.verification.validate.reference_law import LAWS, YEOH, ReferenceLaw

ROUNDING = "rounding of float64, some thousand operations"
SINGLE, OF_SINGLE = 1e-5, "rounding of float32, in which derivatives are taken, some hundred operations"


def internal_forces(body: Elasticity, x: np.ndarray) -> np.ndarray:
    """Residual (unknowns,) of the elastic operator at the state x."""
    out = wp.zeros((len(x), 1), dtype=wp.float64, device=body.device)
    least = wp.full(1, np.inf, dtype=wp.float64, device=body.device)
    body.residual(wp.array(x[:, None], dtype=wp.float64, device=body.device), out, least)
    return out.numpy()[:, 0]


def tangent_action(body: Elasticity, x: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Derivative of the residual at x, times v."""
    out = wp.zeros((len(x), 1), dtype=wp.float32, device=body.device)
    body.linearize(wp.array(x[:, None], dtype=wp.float64, device=body.device))
    body.tangent(wp.array(v[:, None], dtype=wp.float32, device=body.device), out)
    return out.numpy()[:, 0]


def random_state(body: Elasticity, seed: int) -> np.ndarray:
    """Finite strains: displacements of some per cent of an element, pressures of some per cent of E."""
    return 0.03 * np.random.default_rng(seed).normal(size=body.n_displacements + body.n_pressures)


@case("exact-frame", "Frame indifference: a rotated state has the same forces, rotated", "quick")
def frame_indifference(context: Context) -> Outcome:
    mesh, rows = block(inside_only=False), []
    Q = rotation(np.array([1.0, 2.0, -0.5]), 2.4)
    shift = np.array([3.0, -1.0, 2.0])
    n_u = mesh.nodes.size

    def rotate(x: np.ndarray) -> np.ndarray:
        moved = (mesh.nodes + x[:n_u].reshape(-1, 3)) @ Q.T + shift - mesh.nodes
        return np.append(moved.ravel(), x[n_u:])

    def turn(r: np.ndarray) -> np.ndarray:
        return np.append((r[:n_u].reshape(-1, 3) @ Q.T).ravel(), r[n_u:])

    for law in (ReferenceLaw(0.499), YEOH):
        body = make_body(mesh, law, context.device)
        x, v = random_state(body, 1), random_state(body, 2)
        force, action = internal_forces(body, x), tangent_action(body, x, v)
        of_forces = np.abs(internal_forces(body, rotate(x)) - turn(force)).max() / np.abs(force).max()
        of_action = np.abs(tangent_action(body, rotate(x), turn(v)) - turn(action)).max() / np.abs(action).max()
        rigid = np.abs(internal_forces(body, rotate(np.zeros_like(x)))).max()
        rows += [
            Row(f"forces, largest difference by largest force, {law}", "", of_forces, math.nan, 1e-12, "at most",
                ROUNDING),
            Row(f"tangent, the same, {law}", "", of_action, math.nan, SINGLE, "at most", OF_SINGLE),
            Row(f"largest force after a rigid motion, {law}", "E mm2", rigid, math.nan, 1e-13, "at most", ROUNDING),
        ]  # fmt: skip
    return Outcome(rows)


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rodrigues' formula."""
    k = axis / np.linalg.norm(axis)
    K = np.array([[0.0, -k[2], k[1]], [k[2], 0.0, -k[0]], [-k[1], k[0], 0.0]])
    return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K


@case("exact-hooke", "Small strains: the tangent at rest is linear elasticity", "quick")
def hooke(context: Context) -> Outcome:
    mesh, rows = block(inside_only=False), []
    for law in LAWS:
        body = make_body(mesh, law, context.device)
        v = random_state(body, 3)
        ours = tangent_action(body, np.zeros_like(v), v)
        theirs = linear_elastic_action(body, law.poisson_ratio, mesh, v)
        difference = np.abs(ours - theirs).max() / np.abs(theirs).max()
        rows.append(Row(f"tangent at rest against B^T D B, {law}", "", difference, math.nan, SINGLE, "at most",
                        OF_SINGLE))  # fmt: skip
    strain = 1e-6
    next_order = f"strain {strain:g}: the next term of the law is of its order"
    for law in LAWS:
        stress, lateral = pull(block(inside_only=True), law, 1.0 + strain, context.device)
        ratio = (1.0 - lateral) / strain
        for what, unit, ours, exact in (("Young's modulus", "E", stress / strain, 1.0),
                                        ("Poisson's ratio", "", ratio, law.poisson_ratio)):  # fmt: skip
            rows.append(Row(f"{what}, {law}", unit, ours, exact, 10.0 * strain, "relative", next_order))
    return Outcome(rows)


def linear_elastic_action(body: Elasticity, nu: float, mesh: Mesh, v: np.ndarray) -> np.ndarray:
    """Linear elasticity in Voigt's notation, as mixed as the solver: B^T (D B u + m p), m^T B u - p / (lam - gamma)."""
    geometry, m = tet_geometry(P2P1, mesh.nodes, mesh.tetrahedra), body.material
    u, p = v[: body.n_displacements].reshape(-1, 3), v[body.n_displacements :]
    trace = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    mu = 0.5 / (1.0 + nu)
    pointwise = 2.0 * mu * nu / (1.0 - 2.0 * nu) - 1.0 / m.pressure_compliance
    D = pointwise * np.outer(trace, trace) + np.diag([2.0 * mu] * 3 + [mu] * 3)
    forces, volumes = np.zeros_like(u), np.zeros_like(p)
    for e, tet in enumerate(mesh.tetrahedra):
        for q, volume in enumerate(geometry.volumes[e]):
            B = np.zeros((6, 10, 3))
            x, y, z = geometry.gradients[e, q].T
            B[0, :, 0] = B[3, :, 1] = B[5, :, 2] = x
            B[1, :, 1] = B[3, :, 0] = B[4, :, 2] = y
            B[2, :, 2] = B[4, :, 1] = B[5, :, 0] = z
            shapes = geometry.corner_shapes[q]
            strain, pressure = np.tensordot(B, u[tet], 2), shapes @ p[tet[:4]]
            forces[tet] += volume * np.tensordot(D @ strain + pressure * trace, B, 1)
            volumes[tet[:4]] += volume * shapes * (trace @ strain - m.pressure_compliance * pressure)
    return np.append(forces.ravel(), volumes)


@case("exact-tangent", "The tangent against finite differences", "quick")
def tangent(context: Context) -> Outcome:
    rows, curves = [], []
    steps = np.logspace(-1.0, -13.0, 49)
    for what, (forces, action, x) in (
        ("elasticity", elasticity_term(context, ReferenceLaw(0.499))),
        ("Yeoh", elasticity_term(context, YEOH)),
        ("contact", contact_term(context)),
    ):
        v = np.random.default_rng(5).normal(size=len(x))
        errors = difference_errors(forces, action(x, v), x, v, steps)
        for name, order in (("forward", 1), ("central", 2)):
            error = np.array(errors[name])
            truncated = (error < 0.01) & (error > 20.0 * error.min()) & (steps > steps[error.argmin()])
            slope = np.polyfit(np.log(steps[truncated]), np.log(error[truncated]), 1)[0]
            rows += [
                Row(f"{what}: least relative error of {name} differences", "", min(errors[name]), math.nan, 1e-6,
                    "at most", OF_SINGLE),
                Row(f"{what}: order of {name} differences", "", slope, order, 0.05, "absolute", "Taylor's series"),
            ]  # fmt: skip
            curves.append(Curve(f"tangent, {what}", name, [*map(float, steps)], errors[name], "step, mm",
                                "relative error", log=True))  # fmt: skip
    return Outcome(rows, curves=curves, notes=[
        "Elasticity at random finite strains; a sphere of radius 7 mm in contact with a whole face, frictionless. The "
        "tangent of friction leaves out how the tangent plane turns, so that it is no derivative.",
    ])  # fmt: skip


def difference_errors(
    forces: Callable[[np.ndarray], np.ndarray], exact: np.ndarray, x: np.ndarray, v: np.ndarray, steps: np.ndarray
) -> dict[str, list[float]]:
    """Relative errors of forward and central differences of the forces at x along v, for each step."""
    here, errors = forces(x), {"forward": [], "central": []}
    for h in steps:
        ahead, behind = forces(x + h * v), forces(x - h * v)
        for name, difference in (("forward", (ahead - here) / h), ("central", (ahead - behind) / (2.0 * h))):
            errors[name].append(float(np.linalg.norm(difference - exact) / np.linalg.norm(exact)))
    return errors


def elasticity_term(context: Context, law: ReferenceLaw):
    """Forces, tangent action and a state of the elastic body."""
    body = make_body(block(inside_only=False), law, context.device)
    return (lambda x: internal_forces(body, x)), (lambda x, v: tangent_action(body, x, v)), random_state(body, 4)


def contact_term(context: Context):
    """Forces, tangent action and a state of contact: a sphere overlaps the block's top by 0.3 to 0.6 mm."""
    mesh, settings, device = block(inside_only=True), SolverSettings(), context.device
    active = ActiveEnvironments(1, device)
    stiffness = (settings.contact_stiffness, settings.friction_stiffness)
    contact = Contact(P2P1, mesh.nodes, top(mesh.nodes, mesh.faces), stiffness, 0.0, device, active)
    contact.set_shapes([rigid_shape(Kind.SPHERE, 7.0)])
    pose = np.eye(4)[None].copy()
    pose[0, 1, 3] = 0.6
    contact.set_pose(pose)

    def forces(x: np.ndarray) -> np.ndarray:
        out = wp.zeros((len(x), 1), dtype=wp.float64, device=device)
        contact.residual(wp.array(x[:, None], dtype=wp.float64, device=device), out)
        return out.numpy()[:, 0]

    def action(x: np.ndarray, v: np.ndarray) -> np.ndarray:
        out = wp.zeros((len(x), 1), dtype=wp.float32, device=device)
        contact.linearize(wp.array(x[:, None], dtype=wp.float64, device=device))
        contact.tangent(wp.array(v[:, None], dtype=wp.float32, device=device), out)
        return out.numpy()[:, 0]

    return forces, action, np.zeros(mesh.nodes.size)
