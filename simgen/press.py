"""Move indenters in a sensor: from first touch along a path (or through depths), to samples with their certificate."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np
import warp as wp

from .distance import RigidShape
from .errors import InputError
from .fem.krylov import copy_environments
from .fem.newton import SMALLEST_FORCE, SolverSettings, Status
from .first_touch import first_touch
from .scene import MM, Scene

__all__ = ["PressResult", "Scene", "SolverSettings", "Status", "follow", "press"]

EXTRAPOLATION = 0.9  # share of the last step that a new one along the same line starts from
MOST_OVERLAP = 0.25  # of a face's edge: beyond, the mesh does not resolve the contact
LEAST_OVERLAP_MM = 0.01  # that an indenter between the integration points shows before it counts as missed
CERTIFICATE = (
    "residual",
    "contact_error",
    "force_balance",
    "min_det_F",
    "inverted_elements",
    "rms_penetration_m",
    "max_penetration_m",
    "newton_iterations",
    "krylov_iterations",
    "substeps",
)


@dataclass(frozen=True)
class PressResult:
    """One press on one sensor; d depths or points of a path, v vertices of the output mesh.

    displacement : (d, v, 3) m, NaN where the press did not get that far
    force : (d, 3) N on the sensor, normal and friction together, in the sensor's frame
    moment : (d, 3) N m about the origin of the sensor's frame
    status : (d,) int8, codes of :class:`simgen.fem.newton.Status`
    certificate : each (d,): residual and contact_error (relative, see SolverSettings), force_balance (indenter, core
        and reactions of the held nodes, over the indenter's force), min_det_F at quadrature points, elements inverted
        in part between these, penetration in m, iterations, sub-steps; with a liquid also liquid_volume_error, over
        the volume of the cavity
    touch : m, travel along the press axis from the given pose to first touch; NaN where there is none
    seconds : share of this press in the wall time of its batch
    cavity_pressure : (d,) Pa, of the liquid above ambient; None where the scene has none
    """

    displacement: np.ndarray
    force: np.ndarray
    moment: np.ndarray
    status: np.ndarray
    certificate: dict[str, np.ndarray]
    touch: float
    seconds: float
    cavity_pressure: np.ndarray | None = None


def press(scene: Scene, shapes: list[RigidShape], poses: np.ndarray, depths_m: np.ndarray) -> list[PressResult]:
    """Press up to ``scene.batch`` indenters, each along its +y axis to all depths, counted from its first touch.

    poses (b, 4, 4): indenter frame -> sensor frame, m, near the surface; depths_m (d,) increasing.
    """
    depths_m = np.asarray(depths_m, dtype=float)
    return follow(scene, shapes, poses, depths_m[:, None] * np.array([0.0, 1.0, 0.0]))


def follow(scene: Scene, shapes: list[RigidShape], poses: np.ndarray, path_m: np.ndarray) -> list[PressResult]:
    """Move up to ``scene.batch`` indenters along one path, from first touch on, and keep every point of it.

    poses (b, 4, 4): indenter frame -> sensor frame, m, near the surface; path_m (d, 3): offsets from first touch in
    the indenter's frame (+y presses), m, visited in order along straight lines: shear and unloading are paths.
    """
    path_m = np.asarray(path_m, dtype=float)
    if path_m.ndim != 2 or path_m.shape[1] != 3 or not len(path_m) or not np.isfinite(path_m).all():
        raise InputError(f"path of shape {path_m.shape}: allowed: one or more points of three finite coordinates, m")
    if not np.isfinite(poses).all():
        raise InputError("poses: not finite; allowed: rigid transforms, m")
    begin = time.perf_counter()
    count = len(shapes)
    padding = scene.batch - count
    shapes = list(shapes) + [shapes[-1]] * padding
    poses_mm = np.array(poses, dtype=float)
    poses_mm[:, :3, 3] *= MM
    poses_mm = np.concatenate([poses_mm, np.repeat(poses_mm[-1:], padding, axis=0)])
    scene.reset(shapes)
    travel, status = first_touch(scene.nodes, scene.indenter_contact.host_faces, shapes[:count], poses_mm[:count])
    at_touch = poses_mm.copy()
    at_touch[:, :3, 3] += np.pad(travel, (0, padding))[:, None] * poses_mm[:, :3, 1]
    march = _March(scene, at_touch, path_m * MM)
    march.fail(np.flatnonzero(status != Status.CONVERGED), status)
    march.running[count:] = False
    march.to_the_end()
    seconds = (time.perf_counter() - begin) / count
    touch = np.where(status == Status.CONVERGED, travel / MM, np.nan)
    return [march.result(env, float(touch[env]), seconds) for env in range(count)]


@dataclass
class _March:
    """The path of one batch: every environment has its own step and its own next point to store.

    poses (env, 4, 4) at first touch; path (d, 3). ``way`` is the length of path that lies behind an environment, mm.
    """

    scene: Scene
    poses: np.ndarray
    path: np.ndarray
    rows: list[list[dict]] = field(default_factory=list)

    def __post_init__(self):
        batch = self.scene.batch
        self.rows = [[] for _ in range(batch)]
        self._corners = np.vstack([np.zeros(3), self.path])
        lengths = np.linalg.norm(np.diff(self._corners, axis=0), axis=1)
        self._way_to = np.concatenate([[0.0], np.cumsum(lengths)])
        self.way, self.previous = np.zeros((2, batch))
        self.running = np.ones(batch, dtype=bool)
        self.final = np.full(batch, int(Status.CONVERGED))
        self.spacing = float(lengths.max())
        self.step = np.full(batch, self.spacing)
        self.cost = np.zeros((3, batch), dtype=np.int64)  # Newton, Krylov iterations and sub-steps since the last row
        self.x_start, self.x_previous = self.scene.solver.vector(), self.scene.solver.vector()

    def fail(self, environments, status):
        for env in environments:
            self.running[env] = False
            self.final[env] = status[env]

    def offset(self, way: np.ndarray) -> np.ndarray:
        """Offsets (env, 3) from first touch in the indenters' frames, mm."""
        return np.stack([np.interp(way, self._way_to, self._corners[:, i]) for i in range(3)], axis=-1)

    def pose(self, way: np.ndarray) -> np.ndarray:
        moved = self.poses.copy()
        moved[:, :3, 3] += np.einsum("eij,ej->ei", self.poses[:, :3, :3], self.offset(way))
        return moved

    def to_the_end(self):
        while self.running.any():
            self.increment()

    def increment(self):
        """One attempt of a load increment in every running environment."""
        scene, solver = self.scene, self.scene.solver
        solver.active.assign(self.running.astype(np.int32))
        stored = np.array([len(rows) for rows in self.rows])
        goal = self._way_to[1 + np.minimum(stored, len(self.path) - 1)]
        target = np.minimum(self.way + self.step, goal)
        target = np.where(goal - target < 1e-9, goal, target)
        wp.copy(self.x_start, solver.x)
        multipliers = [contact.save() for contact in solver.contacts]
        self.extrapolate(target)
        here = np.tile(np.eye(4), (scene.batch, 1, 1))
        scene.indenter_contact.begin_increment(self.x_start, solver.x, self.pose(self.way), self.pose(target))
        if scene.core_contact is not None:
            scene.core_contact.begin_increment(self.x_start, solver.x, here, here)
        out = solver.solve(self.running)
        self.cost += np.stack([out.newton_iterations, out.krylov_iterations, self.running.astype(np.int64)])
        converged = self.running & (out.status == Status.CONVERGED)
        failed = self.running & ~converged
        if failed.any():
            copy_environments(self.x_start, failed, solver.x)
            for contact, saved in zip(solver.contacts, multipliers, strict=True):
                contact.restore(saved, failed)
            self.step[failed] = (target - self.way)[failed] / 2.0
            hopeless = failed & (self.step < self.scene.settings.smallest_substep * self.spacing)
            self.fail(np.flatnonzero(hopeless), out.status)
        copy_environments(self.x_start, converged, self.x_previous)
        self.previous[converged] = self.way[converged]
        self.way[converged] = target[converged]
        self.step[converged] = np.minimum(2.0 * self.step[converged], self.spacing)
        self.store(converged & (target == goal), out)

    def extrapolate(self, target: np.ndarray):
        """Guess the next state from the last two, as far as the path goes on along (or back) their line.

        Kept where det F stays positive.
        """
        solver = self.scene.solver
        here = self.offset(self.way)
        last, now = here - self.offset(self.previous), self.offset(target) - here
        length = (last**2).sum(axis=-1)
        factor = EXTRAPOLATION * (last * now).sum(axis=-1) / np.where(length > 0.0, length, np.inf)
        x = self.x_start.numpy()
        guess = x + factor * (x - self.x_previous.numpy())
        solver.x.assign(guess)
        _, _, min_det = solver.forces(solver.x)
        copy_environments(self.x_start, min_det < 0.2, solver.x)

    def store(self, reached: np.ndarray, out):
        """Record the samples of the environments that have just reached a depth to store."""
        if not reached.any():
            return
        scene, solver = self.scene, self.scene.solver
        unit = scene.material.youngs_modulus_pa / MM**2  # N per unit of solver force
        force, moment, rms, _ = scene.indenter_contact.resultants(solver.x)
        total = force.copy()
        if scene.core_contact is not None:
            total += scene.core_contact.resultants(solver.x)[0]
        solver.active.assign(reached.astype(np.int32))
        residual = solver.forces(solver.x, hold=False)[0].numpy()
        nodal = residual[: solver.elasticity.n_displacements].reshape(-1, 3, scene.batch)
        total += np.einsum("ni,nie->ei", scene._held, nodal)
        if scene.cavity is not None:
            total += scene.cavity.resultant(solver.x)
        poses = self.pose(self.way)
        for env in np.flatnonzero(reached):
            overlap, of_edge = scene.overlap(env, poses[env])
            entered = not self.rows[env] and self.path[0, 1] > LEAST_OVERLAP_MM
            missed = not force[env].any() and (entered or overlap > LEAST_OVERLAP_MM)
            if missed or of_edge > MOST_OVERLAP:
                self.running[env], self.final[env] = False, Status.NOT_RESOLVED
                continue
            values = {
                "residual": out.residual[env],
                "contact_error": out.contact_error[env],
                "force_balance": np.linalg.norm(total[env]) / max(np.linalg.norm(force[env]), SMALLEST_FORCE),
                "min_det_F": out.min_det[env],
                "inverted_elements": scene.inverted_elements(env),
                "rms_penetration_m": rms[env] / MM,
                "max_penetration_m": max(overlap, 0.0) / MM,
                "newton_iterations": self.cost[0, env],
                "krylov_iterations": self.cost[1, env],
                "substeps": self.cost[2, env],
            }
            if scene.cavity is not None:
                row = scene.cavity.row
                values["liquid_volume_error"] = abs(residual[row, env]) / scene.cavity.volume
                values["cavity_pressure"] = solver.x.numpy()[row, env] * scene.material.youngs_modulus_pa
            displacement = scene.output_displacement(env)
            self.rows[env].append(
                dict(values, displacement=displacement, force=force[env] * unit, moment=moment[env] * unit / MM)
            )
            self.cost[:, env] = 0
            self.running[env] = len(self.rows[env]) < len(self.path)

    def result(self, env: int, touch: float, seconds: float) -> PressResult:
        rows, d = self.rows[env], len(self.path)
        shape = self.scene._to_output.shape[0]

        def column(key, *inner):
            out = np.full((d, *inner), np.nan)
            for i, row in enumerate(rows):
                out[i] = row[key]
            return out

        status = np.full(d, self.final[env], dtype=np.int8)
        status[: len(rows)] = Status.CONVERGED
        certificate = {key: column(key) for key in CERTIFICATE}
        if liquid := self.scene.cavity is not None:
            certificate["liquid_volume_error"] = column("liquid_volume_error")
        vectors = column("displacement", shape, 3), column("force", 3), column("moment", 3)
        pressure = column("cavity_pressure") if liquid else None
        return PressResult(*vectors, status, certificate, touch, seconds, pressure)
