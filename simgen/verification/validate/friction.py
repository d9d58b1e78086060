"""Cases of Coulomb friction: a sliding block, stick and slip under a sphere, no friction, balance of moments.

Bodies have E = 0.539 MPa and nu = 0.499. Lengths are in mm.
"""

from dataclasses import dataclass

import numpy as np

from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind, RigidShape
from simgen.sensors.sensor import Sensor
from simgen.simulation.press import PressResult, Scene, follow
from simgen.units import MM_PER_M
from simgen.verification.validate.case import Context, Curve, Outcome, Row, Table, at_most, case
from simgen.verification.validate.layer_meshes import (
    fixed_symmetric,
    graded,
    make_sensor,
    points_on_top,
    round_layer,
)
from simgen.verification.validate.layer_press import check_reached, layer_gel
from simgen.verification.validate.layer_reference import LINEAR, MODULUS_MPA
from simgen.verification.validate.meshes import box, on_plane, top

COULOMB = 1e-3  # tolerance of the friction coefficient
TARGET = 0.01  # the project's target for forces
BLOCK = (6.0, 2.0, 6.0)
PLATE_MM = (30.0, 1.0)  # half width, far larger than the block's, and radius of the fillet


def slide(
    sensor: Sensor, shape: RigidShape, friction: float, path: np.ndarray, device: str, x: float = 0.0, z: float = 0.0
) -> tuple[Scene, PressResult]:
    """Move a rigid body along a path (k, 3) mm from first touch at (x, z); +y points into the gel.

    Returns the scene in its last state, and the result. Raises RuntimeError if a step does not converge.
    """
    scene = Scene(sensor, layer_gel(friction), device=device)
    pose = np.eye(4)
    pose[[0, 2], 3] = x / MM_PER_M, z / MM_PER_M
    result = follow(scene, [shape], pose[None], path / MM_PER_M)[0]
    check_reached(result.status, lambda i: f"point {i} of the path")
    return scene, result


def press_then_shear(depths: list[float], shears: np.ndarray) -> np.ndarray:
    """Make a path (k, 3) to each depth, then sideways along x."""
    return np.array([(0.0, depth, 0.0) for depth in depths] + [(shear, depths[-1], 0.0) for shear in shears])


def block() -> Sensor:
    """Make a block with a fixed bottom."""
    mesh = box((4, 2, 4), BLOCK)
    return make_sensor(mesh, on_plane(mesh.nodes, 1, BLOCK[1]), top(mesh.nodes, mesh.faces), np.zeros((1, 3)))


def plate() -> RigidShape:
    """Make a plate much wider than the block."""
    return rigid_shape(Kind.CUBE, *PLATE_MM)


def tangential_share(result: PressResult) -> np.ndarray:
    """Return tangential over normal force (k,)."""
    return np.hypot(result.force[:, 0], result.force[:, 2]) / result.force[:, 1]


@case("friction-block", "A block under a plate that is dragged sideways: sticks, then slides at mu N", "quick")
def solve_block(context: Context) -> Outcome:
    """Drag a plate over a block, with two friction coefficients, until it slides."""
    rows, curves = [], []
    for friction, far in ((0.3, 1.2), (0.78, 3.0)):
        shears = np.linspace(0.0, far, 25)[1:]
        _, result = slide(block(), plate(), friction, press_then_shear([0.05, 0.1], shears), context.device)
        share = tangential_share(result)
        rows.append(Row(f"tangential over normal force, sliding, mu = {friction:g}", "", float(share[-1]), friction,
                        COULOMB, "relative", "Coulomb's law; the target of the project"))  # fmt: skip
        rows.append(at_most(f"largest share on the way, mu = {friction:g}", "", float(share.max()),
                            friction * (1.0 + COULOMB), "Coulomb's law"))  # fmt: skip
        curves.append(Curve("a dragged block", f"mu = {friction:g}", [0.0, *shears], [*share[1:]], "plate, mm",
                            "tangential over normal force"))  # fmt: skip
    force = {}
    for steps in (1, 8):
        shears = np.linspace(0.0, 0.1, steps + 1)[1:]
        _, result = slide(block(), plate(), 2.0, press_then_shear([0.05, 0.1], shears), context.device)
        force[steps] = float(result.force[-1, 0])
    rows.append(Row("shear force while it sticks, 8 steps against 1, mu = 2", "N", force[8], force[1], TARGET,
                    "relative", "sticking has no history; the project's target"))  # fmt: skip
    return Outcome(rows, curves=curves)


def reactions(scene: Scene) -> np.ndarray:
    """Return the reactions (n, 3) N of the fixed nodes on the gel, from the stresses in the present state."""
    solver = scene.solver
    n_u = solver.elasticity.n_displacements
    forces = solver.reactions()[:n_u, 0].reshape(-1, 3)
    return np.where(scene.mesh.held.reshape(len(forces), -1), forces, 0.0) * MODULUS_MPA


@case("friction-balance", "Forces and moments of contact and of reactions, on a block that partly slides", "quick")
def solve_balance(context: Context) -> Outcome:
    """Shear a block along both axes by a sphere off its middle, so that no component vanishes.

    Resultants of the contact are sums over its quadrature points. Reactions come from the stresses in the body.
    """
    path = np.array([(0.0, 0.2, 0.0), (0.0, 0.4, 0.0), (0.1, 0.4, -0.05), (0.2, 0.4, -0.1)])
    sphere = rigid_shape(Kind.SPHERE, 3.5)
    scene, result = slide(block(), sphere, 0.78, path, context.device, x=0.7, z=0.4)
    forces = reactions(scene)
    moment = np.cross(scene.nodes / MM_PER_M, forces).sum(axis=0)
    out = {
        "forces": np.linalg.norm(result.force[-1] + forces.sum(axis=0)) / np.linalg.norm(result.force[-1]),
        "moments": np.linalg.norm(result.moment[-1] + moment) / np.linalg.norm(result.moment[-1]),
    }
    tolerance = 10.0 * scene.settings.residual_tolerance
    rows = [at_most(f"|contact + reactions| / |contact|, {name}", "", float(value), tolerance,
                    "zero; 10 x the solver's residual tolerance") for name, value in out.items()]  # fmt: skip
    axes = [*"xyz"]
    table = Table("Resultants on the block, N and N mm", ["of", *axes, *(f"moment about {a}" for a in axes)], [
        ["contact", *map(float, result.force[-1]), *map(float, MM_PER_M * result.moment[-1])],
        ["reactions", *map(float, forces.sum(axis=0)), *map(float, MM_PER_M * moment)],
    ])  # fmt: skip
    return Outcome(rows, [table])


@dataclass(frozen=True)
class Ball:
    """Sphere on a thick layer, nearly a half-space: chi = sqrt(R d) / h = 0.1. The half z >= 0 is meshed."""

    radius: float = 7.0
    height: float = 8.0
    chi: float = 0.1
    edge: float = 0.12

    @property
    def depth(self) -> float:
        """Depth of the press, mm."""
        return (self.chi * self.height) ** 2 / self.radius

    @property
    def contact_radius(self) -> float:
        """Contact radius of linear theory, mm."""
        return LINEAR[self.chi][1] * self.chi * self.height

    def shape(self) -> RigidShape:
        """Make the sphere."""
        return rigid_shape(Kind.SPHERE, self.radius)

    def layer(self, points: np.ndarray) -> Sensor:
        """Make half of the layer, with output at points (p, 3) mm."""
        radii = graded(self.height, self.edge, 1.1 * self.contact_radius, 0.35)
        mesh = round_layer(radii, graded(self.height, self.edge, self.edge, 0.35), segments=3, quarters=2)
        return make_sensor(mesh, fixed_symmetric(mesh, (2,), self.height), top(mesh.nodes, mesh.faces), points)


@case("friction-none", "No drag on a slide without friction: plate on a block, sphere on a layer", "quick")
def solve_none(context: Context) -> Outcome:
    """Drag a plate and a sphere without friction."""
    _, flat = slide(block(), plate(), 0.0, press_then_shear([0.05, 0.1], np.array([0.5, 1.0])), context.device)
    ball = Ball(edge=0.2)
    path = press_then_shear([0.5 * ball.depth, ball.depth], np.array([0.2, 0.4]))
    _, round_ = slide(ball.layer(np.zeros((1, 3))), ball.shape(), 0.0, path, context.device)
    drag = float(np.abs(round_.force[2:, 0] / round_.force[2:, 1]).max())
    return Outcome([
        at_most("drag over normal force, plate on a block, mu = 0", "", float(tangential_share(flat)[-1]), 1e-9,
                "zero: all normals are the plate's"),
        at_most("drag over normal force, sphere on a layer, mu = 0", "", drag, TARGET,
                "zero by symmetry, to the mesh; the project's target of forces"),
    ])  # fmt: skip


SLIPS = 0.1  # a point slips in a step if it lags behind the sphere by more than this share of the step
SLIPS_ANYWHERE = 0.05  # largest lag well inside the stick region


@case("friction-sphere", "A pressed sphere is sheared: slip starts at the contact's edge and grows inwards", "standard")
def solve_sphere(context: Context) -> Outcome:
    """Compare the stick radius with c = a (1 - Q / (mu P))^(1/3) of Cattaneo (1938) and Mindlin (1949).

    The formula (Johnson 1985, eq. 7.41) is exact for small strains of a half-space of equal or incompressible bodies.
    Here the layer is nine contact radii thick. Slip is measured in each step. Outside of c its share of the step is
    1 - 2 / pi arcsin(c / r), which reaches `SLIPS` at 1.012 c.
    """
    ball, friction, step = Ball(), 0.3, 0.005
    azimuths, radii = np.radians(np.arange(0.0, 181.0, 22.5)), np.arange(0.0, 1.2, 0.01)
    points = points_on_top(azimuths, radii)
    path = press_then_shear([0.5 * ball.depth, ball.depth], step * np.arange(1, 9))
    _, result = slide(ball.layer(points), ball.shape(), friction, path, context.device)
    moved = result.displacement.reshape(len(path), len(azimuths), len(radii), 3)[..., 0].mean(axis=1) * MM_PER_M
    lag = 1.0 - np.diff(moved[1:], axis=0) / step  # (step, radius)
    share = result.force[2:, 0] / (friction * result.force[2:, 1])
    expected = ball.contact_radius * (1.0 - share) ** (1.0 / 3.0)
    stick = np.array([radii[np.flatnonzero(row > SLIPS)[0]] for row in lag])
    inside = max(np.abs(row[radii < 0.5 * c]).max() for row, c in zip(lag, expected, strict=True))
    rows = [
        Row(f"radius that sticks, Q = {q:.2f} mu P", "mm", float(c), float(theory), ball.edge, "absolute",
            "Cattaneo and Mindlin; one element's edge")
        for q, c, theory in zip(share, stick, expected, strict=True)
    ]
    rows += [
        at_most("largest growth of that radius in a step", "mm", float(np.diff(stick).max()), 0.0,
                "slip grows inwards"),
        at_most("slip inside half of that radius, over the sphere's", "", float(inside), SLIPS_ANYWHERE,
                "zero; half the threshold of slip"),
    ]  # fmt: skip
    what = "slip in a step of shear under a sphere"
    curves = [Curve(what, f"Q = {q:.2f} mu P", [*radii], [*row], "radius, mm", "slip over the sphere's motion")
              for q, row in zip(share, lag, strict=True)]  # fmt: skip
    return Outcome(rows, curves=curves)
