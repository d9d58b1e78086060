"""Equilibrium of a body under prescribed displacements and dead loads, by the solver of presses.

There is no contact. The loads are one more term of ``simgen.fem``. The operator, Newton's method and the linear solver
are those of presses. Solver units: mm, and E as the unit of stress, so that a body here has E = 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from simgen.config.solver_settings import SolverSettings
from simgen.fem import batch_arrays
from simgen.fem.batch_arrays import ActiveEnvironments
from simgen.fem.elements.elasticity import Elasticity
from simgen.fem.elements.element import P2P1, TET_EDGES, barycentric_p2, face_shapes, tet_geometry, tet_rule
from simgen.fem.material import LAWS
from simgen.fem.nonlinear.newton import SMALLEST_FORCE, NewtonSolver
from simgen.fem.nonlinear.status import Status
from simgen.verification.validate.meshes import Mesh
from simgen.verification.validate.reference_law import ReferenceLaw

Field = Callable[[np.ndarray], np.ndarray]  # of points (..., 3) mm
FINE_RULE = 14  # quadrature points (degree 5) of loads and errors; the solver itself has 8


class DeadLoad:
    """State-independent forces as a term of the solver: nodal forces (n, 3), E mm2, times ``share``."""

    host_faces = np.zeros((0, 6), dtype=np.int32)
    edge = 1.0

    def __init__(self, forces: np.ndarray, n_unknowns: int, device: str):
        column = np.zeros((n_unknowns, 1))
        column[: forces.size, 0] = forces.ravel()
        self._forces = wp.array(column, dtype=wp.float64, device=device)
        self._everywhere = ActiveEnvironments(1, device)
        self.share = 1.0
        self._change = wp.zeros((2, 1), dtype=wp.float64, device=device)  # there are no multipliers

    def residual(self, x, residual_out):
        batch_arrays.add_scaled(residual_out, self._forces, np.array([-self.share]), self._everywhere, residual_out)

    def linearize(self, x):
        pass

    def tangent(self, v, action_out):
        pass

    def blocks(self, block_index, blocks_out, linear: bool):
        pass

    def diagonal(self, diagonal_out):
        pass

    def multiplier_change(self):
        return self._change

    def update_multipliers(self):
        pass


@dataclass(frozen=True)
class Equilibrium:
    """displacement (n, 3) mm; pressure (corners,), E; reactions (n, 3), E mm2: forces at fixed components."""

    displacement: np.ndarray
    pressure: np.ndarray
    reactions: np.ndarray


def make_body(mesh: Mesh, law: ReferenceLaw, device: str) -> Elasticity:
    """Make a P2-P1 body of E = 1 with the solver's own functions of a law, and the volumetric split of presses."""
    split = SolverSettings().volumetric_split
    solid = LAWS[law.name].from_engineering(1.0, law.poisson_ratio, split, **law.constants)
    active = ActiveEnvironments(1, device)
    return Elasticity(P2P1, mesh.nodes, mesh.tetrahedra, mesh.n_corners, solid, device, active)


def solve(
    body: Elasticity,
    fixed: np.ndarray,
    displacement: np.ndarray,
    loads: np.ndarray | None = None,
    steps: int = 1,
    out_of_balance: float = 1e-13,
) -> Equilibrium:
    """Find the equilibrium of a body.

    fixed : (n, 3) bool, components that are prescribed
    displacement : (n, 3) mm, their values, reached in ``steps`` equal steps, as the loads; a first guess elsewhere
    loads : (n, 3) dead forces at the nodes, E mm2
    out_of_balance : largest Euclidean norm of the residual, which holds nodal forces, E mm2, and volumes, mm3

    Raises RuntimeError if the solver gives up, or converges to a state with an inverted element.
    """
    n_u, n_p = body.n_displacements, body.n_pressures
    load = DeadLoad(np.zeros_like(displacement) if loads is None else loads, n_u + n_p, body.device)
    solver = NewtonSolver(body, [load], fixed, 1, SolverSettings(linear_tolerance=1e-4, krylov_size=80))
    step = np.append(displacement.ravel(), np.zeros(n_p)) / steps
    x = np.zeros(n_u + n_p)
    for number in range(1, steps + 1):
        load.share = number / steps
        scale = max(load.share * float(np.linalg.norm(load._forces.numpy())), SMALLEST_FORCE)
        tolerance = {"residual_tolerance": out_of_balance / scale}
        solver.settings = solver.settings.model_copy(update=tolerance)
        solver.x.assign((x + step)[:, None])
        out = solver.solve(np.ones(1, dtype=bool))
        status = Status(out.status[0])
        if status.is_failure or out.min_det[0] <= 0.0:
            reason = status.sentence if status.is_failure else "an element is inverted"
            raise RuntimeError(f"step {number} of {steps}, residual {out.residual[0] * scale:.1e}: {reason}")
        x = solver.x.numpy()[:, 0].copy()
    forces = solver.reactions()[:n_u, 0]
    return Equilibrium(x[:n_u].reshape(-1, 3), x[n_u:], forces.reshape(-1, 3))


@dataclass(frozen=True)
class VolumePoints:
    """Fine quadrature of the rest mesh: positions (e, q, 3) mm, volumes (e, q) mm3, shapes (q, 10), gradients."""

    positions: np.ndarray
    volumes: np.ndarray
    shapes: np.ndarray
    gradients: np.ndarray  # (e, q, 10, 3), 1/mm
    pressure_shapes: np.ndarray  # (q, 4)


def volume_points(mesh: Mesh) -> VolumePoints:
    geometry = tet_geometry(replace(P2P1, quadrature_points=FINE_RULE), mesh.nodes, mesh.tetrahedra)
    shapes = barycentric_p2(tet_rule(FINE_RULE)[0], TET_EDGES)
    positions = np.einsum("qa,eai->eqi", shapes, mesh.nodes[mesh.tetrahedra])
    return VolumePoints(positions, geometry.volumes, shapes, geometry.gradients, geometry.corner_shapes)


def body_load(mesh: Mesh, force: Field) -> np.ndarray:
    """Consistent nodal forces (n, 3), E mm2, of a dead force per rest volume, (..., 3) E/mm."""
    points = volume_points(mesh)
    shares = np.einsum("eq,qa,eqi->eai", points.volumes, points.shapes, force(points.positions))
    return _gather(mesh, mesh.tetrahedra, shares)


def surface_load(mesh: Mesh, faces: np.ndarray, stress: Field) -> np.ndarray:
    """Consistent nodal forces (n, 3), E mm2, of the dead tractions P N on faces (f, 6); P is (..., 3, 3) E."""
    shapes, by_local, weights = face_shapes(P2P1, 6)
    tangents = np.einsum("fai,qaj->fqij", mesh.nodes[faces], by_local)
    area_vectors = np.cross(tangents[..., 0], tangents[..., 1])
    positions = np.einsum("qa,fai->fqi", shapes, mesh.nodes[faces])
    tractions = np.einsum("fqij,fqj->fqi", stress(positions), area_vectors)
    return _gather(mesh, faces, np.einsum("q,qa,fqi->fai", weights, shapes, tractions))


def _gather(mesh: Mesh, parts: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Sum the shares (m, k, 3) of the nodes of parts (m, k)."""
    forces = np.zeros_like(mesh.nodes)
    np.add.at(forces, parts, shares)
    return forces
