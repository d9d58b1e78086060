"""Presses for the benchmarks: contacts of the full paired job with nine indenters on one sensor."""

from dataclasses import dataclass

import numpy as np

from simgen.config.job import load_job
from simgen.config.job_schema import Job
from simgen.fem.nonlinear.status import has_values
from simgen.geometry.signed_distance import RigidShape
from simgen.pipeline.plan import chosen_material, chosen_sensor, make_plan
from simgen.sensors.indenter import chosen_indenters
from simgen.simulation.press import PressResult, Scene


@dataclass(frozen=True)
class Presses:
    """Presses of one sensor: shapes, poses (b, 4, 4) m, and common depths (d,) m."""

    scene: Scene
    shapes: list[RigidShape]
    poses: np.ndarray
    depths_m: np.ndarray

    def some(self, count: int) -> tuple:
        """Arguments of ``press.press`` for ``count`` presses, which repeat if there are fewer."""
        chosen = np.arange(count) % len(self.shapes)
        return self.scene, [self.shapes[i] for i in chosen], self.poses[chosen], self.depths_m


def paired_presses(sensor: str, mesh: str, trajectories: int, batch: int, device: str, overrides=()) -> Presses:
    """Make presses of the first contacts of jobs/paired.yaml on one sensor, in random order."""
    changes = [f"trajectories.count={trajectories}", f"sensors.{sensor}.mesh={mesh}", "outputs={}"]
    job = load_job("paired", [*changes, *overrides])
    plan = make_plan(job)
    scene = job_scene(job, sensor, batch, device)
    poses = np.linalg.inv(plan.arrays[f"{sensor}/pose"]) @ plan.arrays["press/contact_pose"]
    shapes = [indenter.shape() for indenter in chosen_indenters(job)]
    order = np.random.default_rng(0).permutation(len(poses))
    return Presses(scene, [shapes[i] for i in plan.arrays["press/indenter"][order]], poses[order], job.depths_m)


def job_scene(job: Job, sensor: str, batch: int, device: str) -> Scene:
    """Make the scene of a sensor as `simgen run` does."""
    model = chosen_sensor(job, sensor)
    material, outputs = chosen_material(job, sensor, model), job.surface_outputs(sensor)
    return Scene(model, material, device=device, batch=batch, settings=job.solver, outputs=outputs)


def summary(results: list[PressResult], seconds: float) -> dict:
    """Count converged depths, their speed and their iterations."""
    status = np.stack([result.status for result in results])
    converged = int(has_values(status).sum())
    newton, krylov = (
        sum(float(np.nansum(result.certificate[f"{kind}_iterations"])) for result in results)
        for kind in ("newton", "krylov")
    )
    return {
        "presses": len(results),
        "solves": int(status.size),
        "converged": converged,
        "presses_converged": int(has_values(status).all(axis=1).sum()),
        "seconds": round(seconds, 3),
        "solves_per_second": round(converged / seconds, 3),
        "newton_per_solve": round(newton / max(converged, 1), 2),
        "krylov_per_newton": round(krylov / max(newton, 1.0), 2),
    }
