"""The case of a sphere that sticks to a bonded layer, against an axisymmetric code without load steps.

Friction makes the answer depend on where points of the surface stick. The reference solutions with friction count slip
from the start of a step, so they depend on their steps. `layer_axisymmetric` does not.
"""

import numpy as np

from simgen.verification.validate.case import Context, Outcome, Row, Table, case
from simgen.verification.validate.layer import COARSE, COARSER, EDGE_RADII_MM, SIZES, TARGET
from simgen.verification.validate.layer_axisymmetric import sticking_forces
from simgen.verification.validate.layer_press import press_layer

SPHERE_MM, FRICTION = 3.5, 2.0  # hardly anything slides: at 1 mm the force is 0.04 % larger than with 0.78
DEPTHS_MM = (0.5, 1.0, 2.0)
EDGE_MM = 0.15  # with edges of 0.05 mm, the forces at 0.5 and 1 mm differ by 0.02 and 0.03 %
STEPS_MM = {"fine": (0.1, 0.05), COARSE: (0.1,)}


@case("layer-sticking", "Sphere that sticks to a bonded layer, R = 3.5 mm, to 2 mm, on two meshes", "standard")
def solve_sticking(context: Context) -> Outcome:
    """Press in steps of two sizes and compare forces."""
    exact = sticking_forces(SPHERE_MM, DEPTHS_MM, EDGE_MM)
    size = SIZES[SPHERE_MM]
    rows, table = [], []
    for mesh, mesh_size in (("fine", size), (COARSE, size.coarser(COARSER))):
        for step in STEPS_MM[mesh]:
            depths = step * np.arange(1, round(DEPTHS_MM[-1] / step) + 1)
            pressed = press_layer(mesh_size, SPHERE_MM, FRICTION, depths, EDGE_RADII_MM, context.device)
            forces = [float(pressed.force[np.abs(depths - depth).argmin()]) for depth in DEPTHS_MM]
            rows += [
                Row(f"force at {depth:g} mm, {mesh} mesh, steps of {step:g} mm", "N", ours, theirs, TARGET, "relative",
                    "axisymmetric code, a node a step; the project's target")
                for depth, ours, theirs in zip(DEPTHS_MM, forces, exact, strict=True)
            ]  # fmt: skip
            errors = [f"{100.0 * (ours / theirs - 1.0):+.2f} %" for ours, theirs in zip(forces, exact, strict=True)]
            table.append([mesh, f"{step:g} mm", str(pressed.unknowns), *errors])
    columns = ["mesh", "load step", "unknowns", *(f"force at {depth:g} mm" for depth in DEPTHS_MM)]
    return Outcome(rows, [Table("Sphere that sticks to a bonded layer: error of the force", columns, table)])
