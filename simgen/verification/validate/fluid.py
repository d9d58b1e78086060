"""Cases of the fluid in a cavity: thick-walled spheres with closed forms, and presses on a filled BioTac."""

import math
from dataclasses import dataclass

import numpy as np
import trimesh

from simgen.config.solver_settings import SolverSettings
from simgen.fem.elements.cavity import Cavity
from simgen.fem.elements.element import P2P1
from simgen.fem.nonlinear.newton import NewtonSolver
from simgen.fem.nonlinear.status import Status, has_values
from simgen.geometry.surface import enclosed_volume
from simgen.sensors.indenter import load_indenter
from simgen.sensors.sensor import Sensor, load_sensor
from simgen.sensors.sensor_geometry import cavity_faces
from simgen.simulation.press import PressResult, Scene, press
from simgen.units import MM
from simgen.verification.validate.case import Context, Curve, Outcome, Row, Table, at_least, at_most, case
from simgen.verification.validate.equilibrium import DeadLoad, make_body, surface_load
from simgen.verification.validate.inflation import compressible, incompressible
from simgen.verification.validate.meshes import faces_on, on_plane, sphere_shell
from simgen.verification.validate.peer_scene import timed
from simgen.verification.validate.reference_law import ReferenceLaw

RADII = (1.0, 2.0)  # inner and outer radius of the spheres, mm
OCTANT = math.pi / 6.0  # volume of an octant of a ball over the cube of its radius
EXACT = SolverSettings(residual_tolerance=1e-9, linear_tolerance=1e-4, krylov_size=80)


@dataclass(frozen=True)
class Settled:
    """Equilibrium of a filled sphere.

    pressure : of the fluid, in units of E
    inner_radius, outer_radius : mean radii, mm
    out_of_round : largest deviation from the mean inner radius, relative to it
    """

    pressure: float
    inner_radius: float
    outer_radius: float
    out_of_round: float
    newton_iterations: int


def inwards(points: np.ndarray) -> np.ndarray:
    """Return the stress (..., 3, 3) of unit pressure."""
    return np.broadcast_to(-np.eye(3), (*points.shape, 3))


class FilledSphere:
    """Octant of a thick-walled sphere around a fluid, with E = 1 and planes of symmetry."""

    def __init__(self, poisson_ratio: float, device: str, around: int = 4, through: int = 4):
        self.mesh = mesh = sphere_shell(around, through, RADII)
        radius = np.linalg.norm(mesh.nodes, axis=1)
        self.inner, self.outer = (np.abs(radius - r) < 1e-9 for r in RADII)
        fixed = np.stack([on_plane(mesh.nodes, axis, 0.0) for axis in range(3)], axis=1)
        body = make_body(mesh, ReferenceLaw(poisson_ratio), device)
        row = body.n_displacements + body.n_pressures
        wetted = faces_on(mesh.faces, self.inner)
        self.cavity = Cavity(P2P1, mesh.nodes, wetted, fixed, row, device, body.active)
        unit_pressure = surface_load(mesh, faces_on(mesh.faces, self.outer), inwards)
        self.load = DeadLoad(unit_pressure, row + 1, device)
        self.solver = NewtonSolver(body, [self.load], fixed, 1, EXACT, self.cavity)

    def settle(self, injected: float = 0.0, outer_pressure: float = 0.0) -> Settled:
        """Solve for the equilibrium under injected fluid and outer pressure.

        injected : mm3 in the whole sphere; outer_pressure : in units of E. Raises RuntimeError if more fluid is taken
        out than the sphere holds, and if the solver does not converge.
        """
        content = 4.0 / 3.0 * np.pi * RADII[0] ** 3
        if injected <= -content:
            raise RuntimeError(f"{injected:.3g} mm3: the sphere holds {content:.3g} mm3")
        self.cavity.injected.assign(np.array([injected / 8.0]))
        self.load.share = outer_pressure
        out = self.solver.solve(np.ones(1, dtype=bool))
        if out.status[0] != Status.CONVERGED:
            raise RuntimeError(f"{injected:.3g} mm3: {Status(out.status[0]).sentence}")
        x = self.solver.x.numpy()[:, 0]
        moved = self.mesh.nodes + x[: self.mesh.nodes.size].reshape(-1, 3)
        inner, outer = (np.linalg.norm(moved[on], axis=1) for on in (self.inner, self.outer))
        mean = inner.mean()
        out_of_round = np.abs(inner - mean).max() / mean
        return Settled(x[self.cavity.row], mean, outer.mean(), out_of_round, int(out.newton_iterations[0]))


@case("fluid-lame", "A filled shell under outer pressure: Lame's closed form", "quick")
def lame(context: Context) -> Outcome:
    """Compare with u = a (r - A^3 / r^2) and p_c = P (3 K + 4 mu) / (3 K + 4 mu A^3 / B^3).

    The fluid keeps the inner radius A; B is the outer one.
    """
    applied, (inner, outer) = 1e-5, RADII  # in units of E; squares of strains are far below the mesh's error
    rows = []
    for nu in (0.3, 0.499, 0.4999):
        mu, bulk = 0.5 / (1.0 + nu), 1.0 / (3.0 * (1.0 - 2.0 * nu))
        under = 3.0 * bulk + 4.0 * mu * (inner / outer) ** 3
        found = FilledSphere(nu, context.device).settle(outer_pressure=applied)
        origin = "Lame; mesh of 4 x 4 edges, error falls with its cube or faster"
        rows.append(Row(f"cavity pressure / applied pressure, nu = {nu}", "", found.pressure / applied,
                        (3.0 * bulk + 4.0 * mu) / under, 1e-3, "relative", origin))  # fmt: skip
        sinking = applied / under * (outer - inner**3 / outer**2)
        rows.append(Row(f"inward motion of the outer face, over P / E, nu = {nu}", "mm",
                        (outer - found.outer_radius) / applied, sinking / applied, 1e-3, "relative",
                        origin))  # fmt: skip
    return Outcome(rows, notes=["As nu approaches 1/2, fluid and shell have the same pressure and nothing moves."])


@case("fluid-inflation", "Fluid injected into a thick-walled sphere: pressure over its maximum", "quick")
def inflation(context: Context) -> Outcome:
    """Prescribe the volume and solve for the pressure, which passes its maximum."""
    nu, stretches = 0.499, (1.1, 1.2, 1.35, 1.5, 1.75, 2.0, 2.5, 3.0)
    law, sphere = ReferenceLaw(nu), FilledSphere(nu, context.device)
    ours = [sphere.settle(injected=8.0 * OCTANT * (stretch**3 - 1.0)) for stretch in stretches]
    rows = []
    origin = "radial problem of our law, integrated to 1e-12; mesh of 4 x 4 edges: a third of this, falling with h^4"
    for stretch in (1.2, 2.0, 3.0):
        found, own = ours[stretches.index(stretch)], compressible(law, RADII, stretch)
        at = f"with the cavity {stretch:g} times as wide"
        rows += [
            Row(f"cavity pressure {at}", "E", found.pressure, own.pressure, 3e-3, "relative", origin),
            Row(f"outer radius {at}", "mm", found.outer_radius, own.outer_radius, 3e-4, "relative", origin),
        ]
    rows.append(at_most("inner face out of round, largest", "", max(found.out_of_round for found in ours), 3e-3,
                        "a sphere stays a sphere; quadratic faces, 4 on a quarter of a circle"))  # fmt: skip
    fine = np.linspace(1.01, stretches[-1], 60)
    labels = ("width of the cavity / at rest", "pressure of the fluid / E")
    closed = [incompressible(law, RADII, stretch).pressure for stretch in fine]
    curves = [
        Curve("inflation", "ours, nu = 0.499", list(stretches), [found.pressure for found in ours], *labels,
              style="points"),
        Curve("inflation", "incompressible, closed form", [*map(float, fine)], [*map(float, closed)], *labels),
    ]  # fmt: skip
    mean = np.mean([found.newton_iterations for found in ours])
    return Outcome(rows, curves=curves, notes=[f"{mean:.1f} Newton iterations per injection, without sub-steps."])


DEPTHS_MM = tuple(0.1 * i for i in range(1, 21))
CENTRE_M = np.array([-7.5e-3, -9e-3, 0.0])  # below the middle of the pad
SCENES = {"solid, none": ("solid", "none"), "solid, incompressible": ("solid", "incompressible"),
          "effective, none": ("effective", "none")}  # fmt: skip


@dataclass(frozen=True)
class FluidPress:
    """Press on the BioTac at d depths.

    force : (d,) N along the axis; pressure : (d,) Pa; volume : (d,) mm3, change of the cavity's volume
    """

    result: PressResult
    force: np.ndarray
    pressure: np.ndarray
    volume: np.ndarray
    seconds: float


def press_biotac(sensor: Sensor, indenter: str, material: str, fluid: str, device: str) -> FluidPress:
    """Press into the middle of the pad along +y to all `DEPTHS_MM`."""
    scene = Scene(sensor, sensor.materials[material], device=device, fluid=fluid)
    pose = np.eye(4)[None].copy()
    pose[0, :3, 3] = CENTRE_M
    shape, depths = load_indenter(indenter).shape(), MM * np.array(DEPTHS_MM)
    (result,), seconds = timed(device, lambda: press(scene, [shape], pose, depths))
    pressure = np.zeros(len(DEPTHS_MM)) if result.cavity_pressure is None else result.cavity_pressure
    volume = 1e9 * cavity_volume_change(sensor, result.displacement)
    return FluidPress(result, result.force[:, 1], pressure, volume, seconds)


def cavity_volume_change(sensor: Sensor, displacement: np.ndarray) -> np.ndarray:
    """Change (d,) m3 of the cavity's volume for displacements (d, v, 3) m.

    It is computed from triangles of the output mesh, independently of the solver.
    """
    rest = sensor.output_mesh.vertices
    wall = sensor.output_mesh.surface_triangles
    wall = wall[cavity_faces(trimesh.Trimesh(rest, wall, process=False))]
    return np.array([enclosed_volume(rest, wall) - enclosed_volume(rest + u, wall) for u in displacement])


@case("fluid-biotac", "BioTac with and without fluid: sphere and ring at the middle of the pad", "standard")
def biotac(context: Context) -> Outcome:
    """Press with two materials, with and without fluid, and compare forces and shapes."""
    sensor = load_sensor("biotac", "coarse")
    rows, tables, curves, cost, notes = [], [], [], [], []
    for indenter in ("sphere_7mm", "ring_7mm"):
        names = SCENES if indenter == "sphere_7mm" else list(SCENES)[:2]
        pressed = {name: press_biotac(sensor, indenter, *SCENES[name], context.device) for name in names}
        rows += verdicts(indenter, pressed)
        tables.append(by_depth(indenter, pressed, sensor.output_mesh.touchable))
        curves += lines(indenter, pressed)
        cost += costs(indenter, pressed)
        if "effective, none" in pressed:
            ratio = pressed["effective, none"].force[4:] / pressed["solid, incompressible"].force[4:]
            low, high = (sensor.materials["solid"].youngs_modulus_pa / 1e6 * r for r in (ratio.min(), ratio.max()))
            notes.append(f"{indenter}: the filled skin of nu = 0.499 has the force of the effective material where its "
                         f"E is {low:.2f} to {high:.2f} MPa (0.5 to 2 mm).")  # fmt: skip
    tables.append(Table("Cost to 2 mm in 20 steps", ["indenter", "material, fluid", "converged", "sub-steps",
                        "Newton iterations", "Krylov iterations", "seconds of one core"], cost))  # fmt: skip
    return Outcome(rows, tables, curves, notes)


def verdicts(indenter: str, pressed: dict[str, FluidPress]) -> list[Row]:
    """Check convergence, the fluid's volume, force balance and work."""
    empty, filled = pressed["solid, none"], pressed["solid, incompressible"]
    certificate = filled.result.certificate
    unconverged = sum(int(np.count_nonzero(~has_values(p.result.status))) for p in pressed.values())
    share = np.abs(filled.volume).max() / np.abs(empty.volume).max()
    work = {name: np.trapezoid(np.append(0.0, p.force), np.append(0.0, DEPTHS_MM)) for name, p in pressed.items()}
    ratio = work["solid, incompressible"] / work["solid, none"]
    return [
        Row(f"{indenter}: samples not converged", "", unconverged, 0.0, 0.0, "absolute", "none"),
        at_most(f"{indenter}: change of the fluid's volume over the cavity's, largest", "",
                certificate["liquid_volume_error"].max(), 1e-6, "the audit's bound"),
        at_most(f"{indenter}: cavity's change in the output mesh, filled over empty", "", share, 0.05,
                "triangles of 1 mm against quadratic faces of 1.8 mm"),
        at_most(f"{indenter}: force balance with the fluid, worst", "", certificate["force_balance"].max(), 1e-3,
                "the project's 0.1 %"),
        at_least(f"{indenter}: work to 2 mm, filled over empty", "", ratio, 1.0,
                 "a constraint raises the minimum of the energy"),
    ]  # fmt: skip


def by_depth(indenter: str, pressed: dict[str, FluidPress], touchable: np.ndarray) -> Table:
    """Tabulate force, pressure, volume and differences of the skin at some depths."""
    filled = pressed["solid, incompressible"]
    columns = {"depth, mm": np.array(DEPTHS_MM)}
    columns |= {f"force, N: {name}": p.force for name, p in pressed.items()}
    columns["pressure of the fluid, kPa"] = filled.pressure / 1e3
    columns["loss of cavity volume without fluid, mm3"] = -pressed["solid, none"].volume
    for name, p in pressed.items():
        if p is not filled:
            apart = np.linalg.norm(p.result.displacement - filled.result.displacement, axis=2)[:, touchable]
            columns[f"rms distance from the filled skin, um: {name}"] = 1e6 * np.sqrt(np.mean(apart**2, axis=1))
            columns[f"force over that of the filled skin: {name}"] = p.force / filled.force
    rows = [[float(f"{value:.4g}") for value in row] for row in np.column_stack(list(columns.values()))[4::5]]
    return Table(f"{indenter} on the BioTac: material and fluid", list(columns), rows)


def lines(indenter: str, pressed: dict[str, FluidPress]) -> list[Curve]:
    """Plot force and pressure over depth."""
    depths = [0.0, *DEPTHS_MM]
    force = [Curve(f"{indenter}: force", name, depths, [0.0, *map(float, p.force)], "depth, mm", "force, N",
                   style="dashed" if "effective" in name else "line") for name, p in pressed.items()]  # fmt: skip
    kilopascal = [0.0, *map(float, pressed["solid, incompressible"].pressure / 1e3)]
    return [*force, Curve("pressure of the fluid", indenter, depths, kilopascal, "depth, mm", "pressure, kPa")]


def costs(indenter: str, pressed: dict[str, FluidPress]) -> list[list]:
    """Tabulate the cost of each press."""
    rows = []
    for name, p in pressed.items():
        c = p.result.certificate
        counts = [int(np.nansum(c[key])) for key in ("substeps", "newton_iterations", "krylov_iterations")]
        rows.append([indenter, name, f"{np.count_nonzero(has_values(p.result.status))} of {len(DEPTHS_MM)}", *counts,
                     round(p.seconds, 1)])  # fmt: skip
    return rows
