"""Time each setting and measure its error.

Times are seconds per depth: of one core on a CPU, wall-clock time on a GPU. They exclude assembly of the scene and
compilation of kernels. Errors are taken at the last depth, against the finest mesh of the same run.
"""

import csv
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from simgen.dataset.provenance import code_version
from simgen.verification.bench.biotac import measure_biotac
from simgen.verification.bench.settings import (
    BIOTAC,
    DEFAULT,
    FRICTION,
    FRICTIONLESS,
    QUICK,
    TOLERANCES,
    BenchPlan,
    Setting,
    layer_settings,
    mesh_size,
    reference_size,
)
from simgen.verification.validate import peers
from simgen.verification.validate.layer_reference import DEPTHS_MM, REFERENCES
from simgen.verification.validate.peer_scene import SPHERE_MM, PeerSolution
from simgen.verification.validate.record import machine

NAN = float("nan")


@dataclass(frozen=True)
class Measurement:
    """One row of the table; NaN where a column does not apply.

    rmse_um : over the surface that moves by 10 um or more
    """

    scene: str
    code: str
    element: str
    edge_mm: float
    unknowns: int
    residual_tolerance: float
    contact_tolerance: float
    linear_tolerance: float
    changed: str
    terms: str
    seconds_per_depth: float
    newton_per_depth: float
    krylov_per_depth: float
    force_error_percent: float
    rmse_um: float
    converged: bool
    reference: str
    device: str
    machine: str
    commit: str


@dataclass(frozen=True)
class Origin:
    """Columns that all rows of a run share."""

    device: str
    machine: str
    commit: str


def origin(device: str) -> Origin:
    """Look up the machine and the commit."""
    code = code_version()
    name = machine(device)["processor"]
    if device != "cpu":
        import warp as wp

        name = wp.get_device(device).name
    return Origin(device, name, str(code["commit"] or code["source"]) + (" and changes" if code["dirty"] else ""))


def measure_all(quick: bool, device: str, say: Callable[[str], None]) -> list[Measurement]:
    """Measure all rows of a run; ``say`` gets a line for each."""
    plan, where = QUICK if quick else DEFAULT, origin(device)
    say(f"{where.machine}, {device}; kernels are compiled first")
    rows = []
    for scene in plan.scenes:
        rows += measure_layer(plan, scene, where, say)
    if plan.biotac:
        for row in measure_biotac(device):
            rows.append(Measurement(**row, **tolerances(Setting(BIOTAC, NAN)), **asdict(where)))
            say(line(rows[-1]))
    return rows


def solve_layer(setting: Setting, device: str) -> PeerSolution:
    """Solve one setting of a layer scene."""
    size = mesh_size(setting.edge_mm)
    return peers.solve(size, peers.STEPS_MM, device, FRICTION[setting.scene], setting.element, setting.solver)


def measure_layer(plan: BenchPlan, scene: str, where: Origin, say: Callable[[str], None]) -> list[Measurement]:
    """Measure all settings of a layer scene, and the other codes if the scene has no friction."""
    for element in ("P2-P1", "P1"):
        peers.solve(peers.WARM_UP, peers.STEPS_MM[:1], where.device, FRICTION[scene], element)  # compiles
    reference = peers.solve(reference_size(plan), peers.STEPS_MM, where.device, FRICTION[scene])
    known = REFERENCES[SPHERE_MM, FRICTION[scene]].force[DEPTHS_MM.index(peers.STEPS_MM[-1])]
    off = 100.0 * (reference.force[-1] / known - 1.0)
    say(
        f"{scene}: errors against P2-P1, {plan.reference_edge:g} mm, {reference.unknowns} unknowns; "
        f"its force is {off:+.2f} % off the axisymmetric reference"
    )
    rows = []
    for setting in layer_settings(plan, scene):
        solution = solve_layer(setting, where.device)
        if setting.edge_mm == plan.tolerance_edge:  # the shorter of two times, to see small savings
            solution = min(solution, solve_layer(setting, where.device), key=lambda s: s.seconds)
        rows.append(compared(setting, solution, reference, plan, where))
        say(line(rows[-1]))
    if scene == FRICTIONLESS:
        for setting, solution in peer_solutions(plan, say):
            rows.append(compared(setting, solution, reference, plan, where))
            say(line(rows[-1]))
    return rows


def peer_solutions(plan: BenchPlan, say: Callable[[str], None]):
    """Yield (setting, solution) of each installed code, from coarse to fine meshes."""
    points = peers.surface_points()
    wanted = {"ngsolve": plan.ngsolve_edges, "felupe": plan.felupe_cells}
    for package, sizes in wanted.items():
        if sizes and not find_spec(package):
            say(f'{package} is not installed: its rows are left out (pip install "simgen[dev]")')
            continue
        for size in sizes:
            if package == "ngsolve":
                from simgen.verification.validate.peer_ngsolve import solve

                setting = Setting(FRICTIONLESS, size[0], element="P2-P1, own mesh")
            else:
                from simgen.verification.validate.peer_felupe import edge_mm, solve

                setting = Setting(FRICTIONLESS, edge_mm(*size), element="Q2-Q1-Q1 hexahedra")
            yield setting, solve(*size, peers.STEPS_MM, points)


def tolerances(setting: Setting) -> dict:
    """Columns of the solver's tolerances."""
    return {name: getattr(setting.solver, name) for name in TOLERANCES} | {"changed": setting.changed}


def compared(
    setting: Setting, solution: PeerSolution, reference: PeerSolution, plan: BenchPlan, where: Origin
) -> Measurement:
    """Compare a solution with the reference; errors are NaN if it did not converge."""
    depths = len(solution.force)
    row = Measurement(
        scene=setting.scene,
        code=solution.code,
        element=setting.element,
        edge_mm=setting.edge_mm,
        unknowns=solution.unknowns,
        **tolerances(setting),
        terms=setting.terms,
        seconds_per_depth=solution.seconds / depths,
        newton_per_depth=solution.newton / depths,
        krylov_per_depth=solution.krylov / depths,
        force_error_percent=float(100.0 * (solution.force[-1] / reference.force[-1] - 1.0)),
        rmse_um=peers.surface_rmse_um(solution.displacement[-1], reference.displacement[-1]),
        converged=solution.converged,
        reference=f"P2-P1, edges of {plan.reference_edge:g} mm, the same run",
        **asdict(where),
    )
    if solution.code == "simgen":
        return row
    return replace(row, **dict.fromkeys(TOLERANCES, NAN))  # other codes have other tolerances


def line(row: Measurement) -> str:
    """Format a row for the console."""
    what = f"{row.scene:20} {row.code:8} {row.element:18} {row.edge_mm:5.3g} mm {row.unknowns:6d} unknowns"
    outcome = f"{row.force_error_percent:+8.2f} % {row.rmse_um:7.2f} um" if row.converged else "  did not converge"
    return f"{what} {row.seconds_per_depth:8.3f} s/depth {outcome}  {row.changed or row.terms}"


def write_csv(rows: list[Measurement], path: Path) -> None:
    """Write the rows as CSV, numbers with six digits."""
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, [f.name for f in fields(Measurement)])
        table.writeheader()
        for row in rows:
            table.writerow({k: f"{v:.6g}" if isinstance(v, float) and np.isfinite(v) else v
                            for k, v in asdict(row).items()})  # fmt: skip
