"""Discretisation error of the bundled sensors: the same press on the coarse, the default and the fine mesh.

A case is one indenter at one place of one sensor, to 2 mm. What the default mesh gives is compared with the value to
which the three meshes converge (Richardson's extrapolation): for an error C h^p, with h the mean element size by the
number of unknowns N, h = N^(-1/3), the default mesh is off by 1 / (1 - (h_fine / h_default)^p) times its difference to
the fine mesh. p is measured on the three forces and kept within what P2-P1 elements in contact can show, 1.5 to 3.

The fine meshes take minutes for a press, so these cases are "long": name them, or a pattern of their names.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np

from simgen.fem.nonlinear.status import has_values
from simgen.geometry.developed_skin import Skin
from simgen.sensors.indenter import indenter_names, load_indenter
from simgen.sensors.pairing import Contacts, indenter_poses
from simgen.sensors.sensor import Sensor, load_sensor
from simgen.simulation.press import PressResult, Scene, press
from simgen.verification.validate.case import Context, Curve, Outcome, Row, Table, case

SENSORS = ("digit", "biotac")
PLACES_MM = {"centre": (-7.5, 0.0), "side": (-7.5, 5.5), "tip": (-15.5, 0.0)}  # x along the finger, arc across it
MESHES = ("coarse", "default", "fine")
DEPTHS_MM = np.array([0.5, 1.0, 1.5, 2.0])  # a step from each to the next, on all meshes alike
REPORTED = (0, 1, 3)
DEFORMED = 1e-5  # m: a vertex that has moved this far is in the deformation region
ORDERS = np.linspace(1.5, 3.0, 151)
WANTED_FORCE, WANTED_UM = 0.01, 5.0
ORIGIN = "the project's target; reference: three meshes extrapolated"


@dataclass(frozen=True)
class MeshSolution:
    """A press on one mesh: its name, hash and unknowns, and what came of it."""

    mesh: str
    hash: str
    unknowns: int
    result: PressResult

    @property
    def force(self) -> np.ndarray:
        """(d,) N."""
        return np.linalg.norm(self.result.force, axis=1)


def place_indenter(sensor: Sensor, x_mm: float, arc_mm: float) -> np.ndarray:
    """Pose (4, 4): the tip on the skin at (x, arc), pressing against the outward normal there."""
    point, normal = Skin(sensor.surface).point(x_mm * 1e-3, arc_mm * 1e-3)
    one = np.zeros(1)
    return indenter_poses(Contacts(point[None], normal[None], -normal[None], one, one))[0]


def solve(model: str, mesh: str, indenter: str, place: str, device: str) -> MeshSolution:
    """Press one indenter at one place to all depths on the named mesh of a sensor.

    A GPU takes the presses of all indenters at all places together, once for each mesh.
    """
    if device == "cpu":
        return _solve(model, mesh, ((indenter, place),), device)[indenter, place]
    every = tuple((indenter, place) for place in PLACES_MM for indenter in indenter_names())
    return _solve(model, mesh, every, device)[indenter, place]


@lru_cache(maxsize=len(MESHES))
def _solve(model: str, mesh: str, presses: tuple[tuple[str, str], ...], device: str) -> dict[tuple, MeshSolution]:
    sensor = load_sensor(model, mesh)
    scene = Scene(sensor, sensor.materials["solid"], device=device, batch=len(presses))
    shapes = {indenter: load_indenter(indenter).shape() for indenter, _ in presses}
    poses = np.stack([place_indenter(sensor, *PLACES_MM[place]) for _, place in presses])
    results = press(scene, [shapes[indenter] for indenter, _ in presses], poses, DEPTHS_MM * 1e-3)
    found = (MeshSolution(mesh, sensor.simulation_mesh.hash, scene.unknowns, result) for result in results)
    return dict(zip(presses, found, strict=True))


def difference_um(a: np.ndarray, b: np.ndarray) -> float:
    """RMSE (Euclidean distance) of displacements a, b (v, 3) m over the vertices that b moves by 10 um or more.

    NaN where one of them is missing, as not every press gets to the end.
    """
    if np.isnan(a).any() or np.isnan(b).any():
        return np.nan
    moved = np.linalg.norm(b, axis=1) >= DEFORMED
    return float(1e6 * np.sqrt(((a - b)[moved] ** 2).sum(axis=1).mean())) if moved.any() else 0.0


def order(values, sizes) -> float:
    """The p within `ORDERS` with which three values on meshes of sizes h, coarse to fine, differ as C h^p does.

    The least one, which is the careful choice, where they do not approach a limit from one side.
    """
    first, second = values[0] - values[1], values[1] - values[2]
    if first * second <= 0.0:
        return float(ORDERS[0])
    powers = np.asarray(sizes)[:, None] ** ORDERS
    mismatch = np.abs(first * (powers[1] - powers[2]) - second * (powers[0] - powers[1]))
    scale = np.abs(powers[0] - powers[2])
    return float(ORDERS[np.argmin(mismatch / scale)])


def compare(name: str, solutions: list[MeshSolution]) -> Outcome:
    """Rows and tables of one press on three meshes, coarse to fine."""
    sizes = [solution.unknowns ** (-1.0 / 3.0) for solution in solutions]
    rows, table = [], []
    for i in REPORTED:
        depth, force = DEPTHS_MM[i], [float(solution.force[i]) for solution in solutions]
        moved = [solution.result.displacement[i] for solution in solutions]
        p = order(force, sizes)
        factor = 1.0 / (1.0 - (sizes[2] / sizes[1]) ** p)
        limit = force[1] + factor * (force[2] - force[1])
        away = [difference_um(each, moved[2]) for each in moved[:2]]
        rows += [
            Row(f"{name}: force at {depth:g} mm", "N", force[1], limit, WANTED_FORCE, "relative", ORIGIN),
            Row(f"{name}: RMSE of the deformation region at {depth:g} mm", "um", factor * away[1], np.nan, WANTED_UM,
                "at most", ORIGIN),
        ]  # fmt: skip
        table.append([depth, *force, limit, 100.0 * (force[1] / limit - 1.0), 100.0 * (force[1] / force[2] - 1.0),
                      *away, factor * away[1], p])  # fmt: skip
    columns = ["depth, mm", *(f"force, N, {s.mesh}" for s in solutions), "extrapolated", "error, %", "from fine, %",
               "RMSE from fine, um, coarse", "default", "extrapolated", "order"]  # fmt: skip
    meshes = [[s.mesh, s.hash[:12], s.unknowns, s.result.seconds / len(DEPTHS_MM),
               int((~has_values(s.result.status)).sum()), float(np.nanmin(s.result.certificate["min_det_F"]))]
              for s in solutions]  # fmt: skip
    tables = [
        Table(f"{name}: the same press on three meshes", columns, table),
        Table(f"{name}: meshes", ["mesh", "hash", "unknowns", "s per depth", "not converged", "least det F"], meshes),
    ]
    curves = [
        Curve(name, s.mesh, DEPTHS_MM.tolist(), s.force.tolist(), "depth, mm", "force, N") for s in solutions
    ]
    return Outcome(rows, tables, curves)


def against_fine(model: str, place: str, indenter: str, context: Context) -> Outcome:
    solutions = [solve(model, mesh, indenter, place, context.device) for mesh in MESHES]
    return compare(f"{model}, {place}, {indenter}", solutions)


for _model in SENSORS:
    for _place in PLACES_MM:
        for _indenter in indenter_names():
            _title = f"{_indenter} on the {_model}, {_place}: discretisation error of the default mesh"
            case(f"sensors-{_model}-{_place}-{_indenter}", _title, "long")(
                partial(against_fine, _model, _place, _indenter)
            )
