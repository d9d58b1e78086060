"""Comparison with independent codes, NGSolve and FElupe, which solve the same press in the same run.

A sphere of radius 3.5 mm is pressed 1 mm into a quarter of the bonded layer, in three dimensions, with nu = 0.499 and
without friction (`peer_scene`). The ``dev`` extra installs both codes.
"""

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np

from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from simgen.simulation.press import Scene, SolverSettings, press
from simgen.units import MM_PER_M
from simgen.verification.validate.case import Context, Curve, Outcome, Row, Table, at_most, case
from simgen.verification.validate.layer_meshes import points_on_top
from simgen.verification.validate.layer_press import (
    AZIMUTHS,
    MOVED_MM,
    QUARTERS,
    LayerMeshSize,
    layer_gel,
    quarter_layer,
)
from simgen.verification.validate.layer_reference import DEPTHS_MM as REFERENCE_DEPTHS_MM
from simgen.verification.validate.layer_reference import REFERENCES
from simgen.verification.validate.peer_scene import SPHERE_MM, PeerSolution, timed

STEPS_MM = np.arange(1, 11) / 10.0
REPORTED_MM = (0.5, 1.0)
RADII_MM = np.arange(0.1, 9.6, 0.2)  # radii of the surface points that are compared
WANTED_FORCE, WANTED_UM = 0.01, 5.0
SIZE = LayerMeshSize(0.35, 0.7, 0.175, 0.385, segments=7)  # as fine around the axis as along it
WARM_UP = LayerMeshSize(1.2, 0.7, 1.0, 1.5)
# Twice the unknowns change their results at 1 mm by -0.13 % and 0.5 um (NGSolve), +0.37 % and 2.1 um (FElupe).
NGSOLVE_EDGES_MM = 0.25, 1.5
FELUPE_CELLS = 4, 4, 0.5


def surface_points() -> np.ndarray:
    """Return points (azimuths x radii, 3) mm on the top at rest."""
    return points_on_top(AZIMUTHS, RADII_MM)


def solve(
    size: LayerMeshSize,
    depths_mm: np.ndarray,
    device: str,
    friction: float = 0.0,
    element: str = "P2-P1",
    settings: SolverSettings | None = None,
    presses: int = 1,
) -> PeerSolution:
    """Solve the press with simgen; of several equal ``presses`` at once, each has an equal share of the time."""
    settings = (settings or SolverSettings()).model_copy(update={"element": element})
    scene = Scene(quarter_layer(size, RADII_MM), layer_gel(friction), device, batch=presses, settings=settings)
    sphere, depths = rigid_shape(Kind.SPHERE, SPHERE_MM), np.asarray(depths_mm) / MM_PER_M
    poses = np.tile(np.eye(4), (presses, 1, 1))
    (result, *_), seconds = timed(device, lambda: press(scene, [sphere] * presses, poses, depths))
    newton, krylov = (int(np.nansum(result.certificate[f"{name}_iterations"])) for name in ("newton", "krylov"))
    return PeerSolution("simgen", scene.unknowns, seconds / presses, newton, krylov, QUARTERS * result.force[:, 1],
                    result.displacement * MM_PER_M)  # fmt: skip


def surface_rmse_um(u: np.ndarray, reference: np.ndarray) -> float:
    """Root mean square of u - reference, um, over the area that moves by 10 um; both (azimuths x radii, 3) mm."""
    moved = np.linalg.norm(reference, axis=1) >= MOVED_MM
    weight = np.tile(RADII_MM, len(AZIMUTHS)) * moved
    return float(MM_PER_M * np.sqrt((weight * ((u - reference) ** 2).sum(axis=1)).sum() / weight.sum()))


def compare(peer: PeerSolution, ours: PeerSolution) -> Outcome:
    """Compare our solution with the peer's, and tabulate times and forces of both."""
    rows, table = [], []
    origin = f"{peer.code}, live; the project's target"
    converged = REFERENCES[SPHERE_MM, 0.0].force
    for depth in REPORTED_MM:
        i = int(np.abs(STEPS_MM - depth).argmin())
        rmse = surface_rmse_um(ours.displacement[i], peer.displacement[i])
        rows += [
            Row(f"force at {depth:g} mm", "N", float(ours.force[i]), float(peer.force[i]), WANTED_FORCE, "relative",
                origin),
            at_most(f"RMSE of the deformation region at {depth:g} mm", "um", rmse, WANTED_UM, origin),
        ]  # fmt: skip
        expected = converged[REFERENCE_DEPTHS_MM.index(depth)]
        table += [
            [s.code, s.unknowns, s.seconds, s.newton, depth, float(s.force[i]), 100.0 * (s.force[i] / expected - 1.0)]
            for s in (ours, peer)
        ]
    columns = ["code", "unknowns", "s of one core, ten depths", "Newton iterations", "depth, mm", "force, N",
               "force error, % of the axisymmetric reference"]  # fmt: skip
    curves = [
        Curve(f"force against {peer.code}", s.code, STEPS_MM.tolist(), s.force.tolist(), "depth, mm", "force, N",
              style=style)
        for s, style in ((ours, "line"), (peer, "points"))
    ]  # fmt: skip
    return Outcome(rows, [Table(f"simgen and {peer.code}, the same press in one run", columns, table)], curves)


def against(package: str, solve_peer: Callable[[np.ndarray, np.ndarray], PeerSolution], device: str) -> Outcome:
    """Solve with both codes and compare; skipped if the package is not installed."""
    if not find_spec(package):
        return Outcome([], skipped=f'{package} is not installed (pip install "simgen[dev]")')
    peer = solve_peer(STEPS_MM, surface_points())
    solve(WARM_UP, STEPS_MM[:1], device)  # compile kernels
    return compare(peer, solve(SIZE, STEPS_MM, device))


def ngsolve_layer(depths_mm: np.ndarray, points_mm: np.ndarray) -> PeerSolution:
    """Solve the press with NGSolve."""
    from simgen.verification.validate.peer_ngsolve import solve

    return solve(*NGSOLVE_EDGES_MM, depths_mm, points_mm)


def felupe_layer(depths_mm: np.ndarray, points_mm: np.ndarray) -> PeerSolution:
    """Solve the press with FElupe."""
    from simgen.verification.validate.peer_felupe import solve

    return solve(*FELUPE_CELLS, depths_mm, points_mm)


@case("peer-ngsolve", "The same press by NGSolve, live: Taylor-Hood tetrahedra of its own mesh", "standard")
def against_ngsolve(context: Context) -> Outcome:
    return against("ngsolve", ngsolve_layer, context.device)


@case("peer-felupe", "The same press by FElupe, live: quadratic hexahedra with pressure and volume ratio", "standard")
def against_felupe(context: Context) -> Outcome:
    return against("felupe", felupe_layer, context.device)
