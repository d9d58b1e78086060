"""Presses of a sphere into the pad of a GelSight sensor: a commercial code's published force, and measured forces.

The pad is a block of 25.25 x 20.75 x 4 mm, bonded below. A quarter of it is solved. Lengths are in mm.
"""

import csv
from dataclasses import dataclass

import numpy as np

from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from simgen.geometry.tetrahedra import sizing_grid
from simgen.sensors.material import Material
from simgen.simulation.press import Scene, press
from simgen.units import MM_PER_M
from simgen.verification.validate.case import Context, Curve, Outcome, Row, Table, case
from simgen.verification.validate.layer_meshes import fixed_symmetric, graded, make_sensor
from simgen.verification.validate.layer_press import check_reached
from simgen.verification.validate.meshes import Mesh, quadratic, top

LENGTH_MM, WIDTH_MM, HEIGHT_MM = 25.25, 20.75, 4.0
QUARTERS = 4
STEP_MM = 0.1
# ANSYS MAPDL 2025R2, 8,640 elements SOLID185 refined to 0.3 mm, from github.com/irisxu02/gelsight_ansys_sim: sphere of
# R = 3 mm, 0.8 mm deep. Its force and reaction differ by 0.68 %, which is about what the figure is worth.
MAPDL_N, MAPDL_TOLERANCE = 0.36087, 0.01
MAPDL_ORIGIN = "MAPDL 2025R2, published; its own balance is 0.68 %"
# Sphere of R = 7.5 mm, values that github.com/feats-ai/feats takes as measured. Modulus and friction are not stated, so
# only ratios of forces are compared.
MEASURED_FILE = "measured/gelsight_mini_force.csv"
MEASURED_SPHERE_MM, MEASURED_TOLERANCE = 7.5, 0.15
FRICTIONS = 0.0, 0.3, 0.78


@dataclass(frozen=True)
class PadMeshSize:
    """Edge lengths, mm: ``edge`` up to ``until`` from the axis, growing by ``growth`` per mm beyond; ``top`` below."""

    edge: float
    until: float
    growth: float
    top: float


def quarter_pad(size: PadMeshSize) -> Mesh:
    """Mesh a quarter of the pad: x and z from 0, the top at y = 0."""
    ticks = [
        graded(0.5 * LENGTH_MM, size.edge, size.until, size.growth),
        graded(HEIGHT_MM, size.top, size.top, size.growth),
        graded(0.5 * WIDTH_MM, size.edge, size.until, size.growth),
    ]
    lattice, tetrahedra = sizing_grid(np.zeros(3), np.array([len(each) - 1.0 for each in ticks]), 1.0)

    def place(numbers: np.ndarray) -> np.ndarray:
        return np.column_stack([np.interp(numbers[:, i], np.arange(len(ticks[i])), ticks[i]) for i in range(3)])

    return quadratic(lattice, tetrahedra, place)


def pad_forces(
    size: PadMeshSize, material: Material, sphere_mm: float, depth_mm: float, device: str
) -> tuple[np.ndarray, int]:
    """Forces (d,) N of the whole pad at all steps of `STEP_MM`, and the number of unknowns of the quarter.

    Raises RuntimeError if a depth does not converge.
    """
    mesh = quarter_pad(size)
    fixed = fixed_symmetric(mesh, (0, 2), HEIGHT_MM)
    scene = Scene(make_sensor(mesh, fixed, top(mesh.nodes, mesh.faces), np.zeros((1, 3))), material, device=device)
    depths = STEP_MM * np.arange(1, round(depth_mm / STEP_MM) + 1)
    result = press(scene, [rigid_shape(Kind.SPHERE, sphere_mm)], np.eye(4)[None], depths / MM_PER_M)[0]
    check_reached(result.status, lambda i: f"{depths[i]:g} mm")
    return QUARTERS * result.force[:, 1], scene.unknowns


@case("pad-mapdl", "Sphere of R = 3 mm on a soft pad, against a force that MAPDL gives", "standard")
def mapdl(context: Context) -> Outcome:
    """Compare on two meshes, so that the table shows our own error, too."""
    gel = Material(youngs_modulus_pa=100e3, poisson_ratio=0.49, friction=0.5, source="the reference's")
    table = []
    for edge in (0.45, 0.3):
        forces, unknowns = pad_forces(PadMeshSize(edge, 2.0, 0.35, edge), gel, 3.0, 0.8, context.device)
        table.append([edge, unknowns, float(forces[-1])])
    row = Row("force at 0.8 mm", "N", table[-1][-1], MAPDL_N, MAPDL_TOLERANCE, "relative", MAPDL_ORIGIN)
    return Outcome([row], [Table("Force by mesh", ["edge, mm", "unknowns of a quarter", "force, N"], table)])


@case("pad-measured", "Sphere of R = 7.5 mm on a GelSight Mini's pad, ratios of measured forces", "standard")
def measured(context: Context) -> Outcome:
    """Compare forces over the force at 1 mm, which need no modulus. The tolerance is for friction 0."""
    file = None if context.reference is None else context.reference / MEASURED_FILE
    if file is None or not file.is_file():
        return Outcome([], skipped=f"no {MEASURED_FILE} in the reference data: it belongs to others")
    with open(file, newline="", encoding="utf-8") as lines:
        points = [(float(row["depth_mm"]), float(row["force_N"])) for row in csv.DictReader(lines)]
    depths, forces = np.array(points).T
    one = int(np.argmin(np.abs(depths - 1.0)))
    rows, table, curves = [], [], []
    for friction in FRICTIONS:
        gel = Material(youngs_modulus_pa=400e3, poisson_ratio=0.499, friction=friction, source="any: only ratios count")
        size = PadMeshSize(0.8, 6.0, 0.3, 0.6)
        ours, _ = pad_forces(size, gel, MEASURED_SPHERE_MM, float(depths.max()), context.device)
        at = [round(depth / STEP_MM) - 1 for depth in depths]
        ratios, expected = ours[at] / ours[at[one]], forces / forces[one]
        table.append([friction, *map(float, ratios)])
        if friction == 0.0:
            rows = [Row(f"force at {depth:g} mm over force at 1 mm", "", float(own), float(wanted), MEASURED_TOLERANCE,
                        "relative", "measured by others; their rig and friction are not described")
                    for depth, own, wanted in zip(depths, ratios, expected, strict=True) if depth != 1.0]  # fmt: skip
        curves.append(Curve("pad", f"friction {friction:g}", depths.tolist(), ratios.tolist(), "depth, mm",
                            "force over force at 1 mm"))  # fmt: skip
    curves.append(Curve("pad", "measured", depths.tolist(), expected.tolist(), "depth, mm", "force over force at 1 mm",
                        style="points"))  # fmt: skip
    columns = ["friction", *(f"{depth:g} mm" for depth in depths)]
    measured_row = ["measured", *map(float, expected)]
    return Outcome(rows, [Table("Force over the force at 1 mm", columns, [measured_row, *table])], curves)
