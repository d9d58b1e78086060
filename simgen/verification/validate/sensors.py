"""Cases of the bundled sensors' discretisation error: the same press on the coarse, default and fine mesh.

A case presses one indenter at one place of one sensor, to 2 mm. It compares the default mesh with Richardson's
extrapolation of the three meshes. For an error C h^p, with the mean element size h = N^(-1/3) of N unknowns, the
default mesh is off by 1 / (1 - (h_fine / h_default)^p) times its difference to the fine mesh. The forces give p, within
the range of P2-P1 elements in contact, 1.5 to 3.

A press on the fine mesh takes minutes, so these cases are "long" and are run only by name.
"""

from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np

from simgen.fem.nonlinear.status import has_values
from simgen.geometry.developed_skin import Skin
from simgen.sensors.indenter import indenter_names, load_indenter
from simgen.sensors.pairing import Contacts, indenter_poses
from simgen.sensors.sensor import Sensor, load_sensor
from simgen.simulation.press import PressResult, Scene, press
from simgen.units import MM, UM_PER_M
from simgen.verification.validate.case import Context, Curve, Outcome, Row, Table, at_most, case

SENSORS = ("digit", "biotac", "gelsight_mini")
PLACES_MM = {"centre": (-7.5, 0.0), "side": (-7.5, 5.5), "tip": (-15.5, 0.0)}  # x along the finger, arc across it
MESHES = ("coarse", "default", "fine")
DEPTHS_MM = np.arange(1, 21) * 0.1  # as in the dataset, the same on all meshes
REPORTED = (4, 9, 19)  # indices of the depths that are compared: 0.5, 1 and 2 mm
DEFORMED = 1e-5  # m, displacement from which a vertex belongs to the deformation region, as published
ORDERS = np.linspace(1.5, 3.0, 151)
WANTED_FORCE, WANTED_UM = 0.01, 5.0
ORIGIN = "the project's target; reference: three meshes extrapolated"


@dataclass(frozen=True)
class MeshSolution:
    """Result of a press on one mesh, with a name and hash of the mesh."""

    mesh: str
    hash: str
    unknowns: int
    result: PressResult

    @property
    def force(self) -> np.ndarray:
        """Lengths of the forces (d,) N."""
        return np.linalg.norm(self.result.force, axis=1)


def place_indenter(sensor: Sensor, x_mm: float, arc_mm: float) -> np.ndarray:
    """Return the pose (4, 4) of an indenter that touches the skin at (x, arc) and presses against its normal."""
    points, normals = Skin(sensor.surface).points([x_mm * MM], [arc_mm * MM])
    one = np.zeros(1)
    return indenter_poses(Contacts(points, normals, -normals, one, one))[0]


def solve(model: str, mesh: str, indenter: str, place: str, device: str) -> MeshSolution:
    """Press one indenter at one place to all depths on the named mesh of a sensor.

    A GPU solves the presses of all indenters at all places together, once for each mesh.
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
    results = press(scene, [shapes[indenter] for indenter, _ in presses], poses, DEPTHS_MM * MM)
    found = (MeshSolution(mesh, sensor.simulation_mesh.hash, scene.unknowns, result) for result in results)
    return dict(zip(presses, found, strict=True))


def distances_um(a: np.ndarray, b: np.ndarray, moved: np.ndarray | None = None) -> tuple[float, float]:
    """Return root mean square and mean of the Euclidean distance, um, of positions or displacements (v, 3) m.

    Averages over all vertices, or over the deformation region: the vertices where ``moved`` (v, 3) m is at least 10 um.
    The ACROSS framework takes the root mean square over coordinates, which is smaller by a factor of sqrt(3). NaN if a
    press did not reach this depth.
    """
    away = UM_PER_M * np.linalg.norm(a - b, axis=1)
    if np.isnan(away).any():
        return np.nan, np.nan
    if moved is not None:
        away = away[np.linalg.norm(moved, axis=1) >= DEFORMED]
    return (float(np.sqrt((away**2).mean())), float(away.mean())) if len(away) else (0.0, 0.0)


def difference_um(a: np.ndarray, b: np.ndarray) -> float:
    """Return the RMSE, um, of displacements a, b (v, 3) m over the vertices that b moves by 10 um or more."""
    return distances_um(a, b, b)[0]


def order(values, sizes) -> float:
    """Fit p within `ORDERS` to three values with errors C h^p on meshes of sizes h, coarse to fine.

    The smallest p, a cautious choice, if the values do not approach their limit from one side.
    """
    first, second = values[0] - values[1], values[1] - values[2]
    if first * second <= 0.0:
        return float(ORDERS[0])
    powers = np.asarray(sizes)[:, None] ** ORDERS
    mismatch = np.abs(first * (powers[1] - powers[2]) - second * (powers[0] - powers[1]))
    scale = np.abs(powers[0] - powers[2])
    return float(ORDERS[np.argmin(mismatch / scale)])


def compare(name: str, solutions: list[MeshSolution]) -> Outcome:
    """Compare one press on three meshes, coarse to fine."""
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
            at_most(f"{name}: RMSE of the deformation region at {depth:g} mm", "um", factor * away[1], WANTED_UM,
                    ORIGIN),
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
    curves = [Curve(name, s.mesh, DEPTHS_MM.tolist(), s.force.tolist(), "depth, mm", "force, N") for s in solutions]
    return Outcome(rows, tables, curves)


def against_fine(model: str, place: str, indenter: str, context: Context) -> Outcome:
    """Press on all meshes and compare."""
    solutions = [solve(model, mesh, indenter, place, context.device) for mesh in MESHES]
    return compare(f"{model}, {place}, {indenter}", solutions)


for _model in SENSORS:
    for _place in PLACES_MM:
        for _indenter in indenter_names():
            _title = f"{_indenter} on the {_model}, {_place}: discretisation error of the default mesh"
            case(f"sensors-{_model}-{_place}-{_indenter}", _title, "long")(
                partial(against_fine, _model, _place, _indenter)
            )
