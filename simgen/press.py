"""Move indenters in a sensor: from first touch along a path (or through depths), to samples with their certificate."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from .distance import RigidShape
from .errors import InputError
from .fem.newton import SolverSettings
from .fem.status import Status
from .first_touch import first_touch
from .march import March
from .scene import MM, Scene

__all__ = ["PressResult", "Scene", "SolverSettings", "Status", "follow", "press"]

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
    status : (d,) int8, codes of :class:`simgen.fem.status.Status`
    certificate : each (d,): residual and contact_error (relative, see SolverSettings), force_balance (indenter, core
        and reactions of the held nodes, over the indenter's force), min_det_F at quadrature points, elements inverted
        in part between these, penetration in m, iterations, sub-steps; with a liquid also liquid_volume_error, over
        the volume of the cavity
    touch : m, travel along the press axis from the given pose to first touch; NaN where there is none
    seconds : share of this press in the wall time of those that were solved together
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
    """Press any number of indenters, each along its +y axis to all depths, counted from its first touch.

    poses (b, 4, 4): indenter frame -> sensor frame, m, near the surface; depths_m (d,) increasing. ``scene.batch`` of
    them are under way at a time; one that ends makes room for the next.
    """
    depths_m = np.asarray(depths_m, dtype=float)
    return follow(scene, shapes, poses, depths_m[:, None] * np.array([0.0, 1.0, 0.0]))


def follow(scene: Scene, shapes: list[RigidShape], poses: np.ndarray, path_m: np.ndarray) -> list[PressResult]:
    """Move indenters along one path, from first touch on, and keep every point of it.

    poses (b, 4, 4): indenter frame -> sensor frame, m, near the surface; path_m (d, 3): offsets from first touch in
    the indenter's frame (+y presses), m, visited in order along straight lines: shear and unloading are paths.
    """
    path_m = np.asarray(path_m, dtype=float)
    if path_m.ndim != 2 or path_m.shape[1] != 3 or not len(path_m) or not np.isfinite(path_m).all():
        raise InputError(f"path of shape {path_m.shape}: allowed: one or more points of three finite coordinates, m")
    if not np.isfinite(poses).all():
        raise InputError("poses: not finite; allowed: rigid transforms, m")
    if not len(shapes):
        return []
    begin = time.perf_counter()
    poses_mm = np.array(poses, dtype=float)
    poses_mm[:, :3, 3] *= MM
    scene.reset(shapes)
    faces, device = scene.indenter_contact.host_faces, scene.device
    path = path_m * MM
    reach = float(np.linalg.norm(path, axis=1).max())
    travel, status, near = first_touch(scene.nodes, faces, shapes, poses_mm, device, scene.batch, reach)
    poses_mm[:, :3, 3] += travel[:, None] * poses_mm[:, :3, 1]
    # Those that touch the most take the longest: they go first, as the end of a batch waits for its slowest presses.
    march = March(scene, poses_mm, path, status, np.argsort(-near, kind="stable"))
    march.to_the_end()
    seconds = (time.perf_counter() - begin) / len(shapes)
    touch = np.where(status == Status.CONVERGED, travel / MM, np.nan)
    results = []
    for i, final in enumerate(march.final):
        displacement = march.displacement[i]
        if displacement is None:
            displacement = np.empty((len(path_m), scene.n_vertices, 3))
        liquid = scene.cavity is not None
        results.append(_result(march.rows[i], displacement, final, liquid, float(touch[i]), seconds))
    return results


def _result(rows: list[dict], displacement: np.ndarray, final: int, liquid: bool, touch: float, seconds) -> PressResult:
    """The samples of one press, which ended with ``final``, as arrays over its depths."""
    d = len(displacement)
    displacement[len(rows) :] = np.nan

    def column(key, *inner):
        out = np.full((d, *inner), np.nan)
        for i, row in enumerate(rows):
            out[i] = row[key]
        return out

    status = np.full(d, final, dtype=np.int8)
    status[: len(rows)] = Status.CONVERGED
    certificate = {key: column(key) for key in CERTIFICATE}
    if liquid:
        certificate["liquid_volume_error"] = column("liquid_volume_error")
    pressure = column("cavity_pressure") if liquid else None
    force, moment = column("force", 3), column("moment", 3)
    return PressResult(displacement, force, moment, status, certificate, touch, seconds, pressure)
