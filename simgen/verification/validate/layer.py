"""Cases of a rigid sphere on a bonded, nearly incompressible layer, against an axisymmetric code and linear theory.

Each case is solved in three dimensions on two meshes of a quarter of the layer. Surface displacements are compared if
the reference data have them; forces and contact radii always.
"""

from functools import partial

import numpy as np

from simgen.verification.validate.case import Context, Curve, Outcome, Row, Table, at_most, case
from simgen.verification.validate.layer_press import (
    LayerMeshSize,
    LayerPress,
    contact_radius,
    press_layer,
    pressure_swing,
    surface_error,
)
from simgen.verification.validate.layer_reference import (
    DEPTHS_MM,
    HEIGHT_MM,
    LINEAR,
    PRESSURE_SCATTER,
    REFERENCES,
    dimitriadis_force,
    hertz_force,
    read_profiles,
)

UM = 1e3  # um in a mm
TARGET, TARGET_UM = 0.01, 5.0  # the project's targets for force and surface displacement
STEP_MM = 0.1
SHOWN_MM = (0.5, 1.0, 2.0)  # depths of the surfaces in the plot
EDGE_RADII_MM = np.arange(0.0, 6.0, 0.02)  # radii at which the contact's edge is searched
SIZES = {
    1.75: LayerMeshSize(0.15, 0.5, 0.15, 0.2),
    3.5: LayerMeshSize(0.2, 0.7, 0.1, 0.22),
    7.0: LayerMeshSize(0.3, 1.0, 0.1, 0.3),
}
COARSER = 1.5
COARSE = f"edges x {COARSER:g}"


def named(sphere: float, friction: float) -> str:
    """Name a sphere and its friction."""
    return f"R = {sphere:g} mm, " + (f"friction {friction:g}" if friction else "frictionless")


def origin(sphere: float, friction: float) -> str:
    """Name the source of a reference."""
    return "NGSolve" + (f", {REFERENCES[sphere, friction].steps} load steps" if friction else "")


def increments(deepest: float) -> np.ndarray:
    """List depths in steps of `STEP_MM`, and the reference's depths between them."""
    steps = np.arange(1, round(deepest / STEP_MM) + 1) * STEP_MM
    return np.unique(np.concatenate([steps, [d for d in DEPTHS_MM if d <= deepest]]).round(9))


def press_as_reference(
    size: LayerMeshSize, sphere: float, friction: float, deepest: float, profiles, device
) -> LayerPress:
    """Press to all depths, with output at the radii of the reference profiles."""
    radii = np.unique(np.concatenate([EDGE_RADII_MM, *(p[:, 0] for p in profiles.values())]).round(9))
    return press_layer(size, sphere, friction, increments(deepest), radii, device)


def reference_rows(pressed: LayerPress, friction: float, edge: float, profiles, depths) -> list[Row]:
    """Compare force, contact radius and surface at depths of the reference."""
    sphere = pressed.sphere
    reference, source = REFERENCES[sphere, friction], origin(sphere, friction)
    rows = []
    for depth in depths:
        i, where = DEPTHS_MM.index(depth), f"at {depth:g} mm, {named(sphere, friction)}"
        rows.append(Row(f"force {where}", "N", float(pressed.force[pressed.at(depth)]), reference.force[i], TARGET,
                        "relative", f"{source}; the project's target"))  # fmt: skip
        rows.append(Row(f"contact radius {where}", "mm", contact_radius(pressed, depth), reference.contact_radius[i],
                        edge, "absolute", f"{source}; one element's edge"))  # fmt: skip
        if depth in profiles:
            rows.append(at_most(f"surface displacement RMSE {where}", "um",
                                UM * surface_error(pressed, depth, profiles[depth]), TARGET_UM,
                                f"{source}; the project's target; deformation region, weighted by area"))  # fmt: skip
    return rows


def two_mesh_rows(fine: LayerPress, coarse: LayerPress, friction: float) -> list[Row]:
    """Compare both meshes at the last depth. Oscillating multipliers would swing more on the finer mesh."""
    sphere = fine.sphere
    reference, where = REFERENCES[sphere, friction], f"at {fine.depths[-1]:g} mm, {named(sphere, friction)}"
    falls = f"that with {COARSE}"
    return [
        Row(f"force {where}, {COARSE}", "N", float(coarse.force[-1]), reference.force[-1], TARGET, "relative",
            f"{origin(sphere, friction)}; the project's target"),
        Row(f"pressure in the centre {where}", "MPa", float(fine.pressure[0].mean()), reference.pressure,
            PRESSURE_SCATTER, "relative", "NGSolve; scatter of its orders 2 and 3"),
        at_most(f"pressure swing between neighbours {where}", "of centre", pressure_swing(fine), pressure_swing(coarse),
                falls),
        at_most(f"overlap rms {where}", "um", fine.overlap_um(), coarse.overlap_um(), falls),
    ]  # fmt: skip


def mesh_table(meshes: dict[str, LayerPress], friction: float) -> Table:
    """Tabulate cost and error of each mesh."""
    columns = ["mesh", "unknowns", "seconds", "Newton iterations", "sub-steps", "overlap rms, um", "least det F"]
    rows = []
    for name, p in meshes.items():
        c = p.result.certificate
        iterations, substeps = (int(c[key].sum()) for key in ("newton_iterations", "substeps"))
        errors = [f"{100.0 * (p.force[p.at(d)] / force - 1.0):+.2f} %"
                  for d, force in zip(DEPTHS_MM, REFERENCES[p.sphere, friction].force, strict=True)]  # fmt: skip
        rows.append([name, str(p.unknowns), p.result.seconds, str(iterations), str(substeps), p.overlap_um(),
                     float(c["min_det_F"].min()), *errors])  # fmt: skip
    columns += [f"force at {depth:g} mm" for depth in DEPTHS_MM]
    return Table(f"Bonded layer, {named(next(iter(meshes.values())).sphere, friction)}", columns, rows)


def curves(meshes: dict[str, LayerPress], friction: float, profiles) -> list[Curve]:
    """Plot force over depth, the surface, and the pressure at the last depth."""
    fine = next(iter(meshes.values()))
    what, reference = named(fine.sphere, friction), REFERENCES[fine.sphere, friction]
    force = f"force, {what}", ("depth, mm", "force, N")
    surface = f"surface, {what}", ("rest radius, mm", "displacement into the layer, mm")
    pressure = f"contact pressure at 2 mm, {what}", ("rest radius, mm", "pressure per rest area, MPa")
    lines = [Curve(force[0], "NGSolve", [*DEPTHS_MM], [*reference.force], *force[1], style="points")]
    for name, p in meshes.items():
        lines.append(Curve(force[0], name, [*p.depths], [*p.force], *force[1]))
        shown = p.rings < 1.3 * reference.contact_radius[-1]
        means = np.array([values.mean() for values in p.pressure])
        lines.append(Curve(pressure[0], name, [*p.rings[shown]], [*means[shown]], *pressure[1]))
    for depth in SHOWN_MM if profiles else ():
        profile = profiles[depth]
        ours = fine.displacement[fine.at(depth), :, :, 1].mean(axis=0)
        lines.append(Curve(surface[0], f"{depth:g} mm", [*fine.radii], [*ours], *surface[1]))
        lines.append(Curve(surface[0], f"NGSolve, {depth:g} mm", [*profile[:, 0]], [*profile[:, 2]], *surface[1],
                           style="points"))  # fmt: skip
    return lines


def without(profiles) -> list[str]:
    """Note that surface displacements are missing."""
    return [] if profiles else ["the reference data have no surface displacements to compare with"]


def solve_layer(context: Context, sphere: float, friction: float) -> Outcome:
    """Press one sphere to 2 mm on two meshes and compare."""
    profiles = read_profiles(context.reference, sphere, friction)
    sizes = {"fine": SIZES[sphere], COARSE: SIZES[sphere].coarser(COARSER)}
    meshes = {
        name: press_as_reference(size, sphere, friction, DEPTHS_MM[-1], profiles, context.device)
        for name, size in sizes.items()
    }
    rows = reference_rows(meshes["fine"], friction, SIZES[sphere].edge, profiles, DEPTHS_MM)
    rows += two_mesh_rows(meshes["fine"], meshes[COARSE], friction)
    return Outcome(rows, [mesh_table(meshes, friction)], curves(meshes, friction, profiles), without(profiles))


for _sphere, _friction in REFERENCES:
    _name = f"layer-{_sphere:g}mm" + (f"-friction-{_friction:g}" if _friction else "")
    case(_name, f"Sphere on a bonded layer, {named(_sphere, _friction)}, to 2 mm", "standard")(
        partial(solve_layer, sphere=_sphere, friction=_friction)  # picklable, for worker processes
    )


@case("layer-quick", "Sphere on a bonded layer, R = 3.5 mm, with and without friction, to 1 mm", "quick")
def solve_quick(context: Context) -> Outcome:
    """Press on the coarser mesh only; it meets the targets at 0.5 and 1 mm."""
    sphere, size = 3.5, SIZES[3.5].coarser(COARSER)
    rows, profiles = [], {}
    for friction in (0.0, 0.78):
        profiles = read_profiles(context.reference, sphere, friction)
        pressed = press_as_reference(size, sphere, friction, 1.0, profiles, context.device)
        rows += reference_rows(pressed, friction, size.edge, profiles, (0.5, 1.0))
    return Outcome(rows, notes=without(profiles))


@case("layer-linear", "Small indentation of a wide bonded layer, frictionless, against linear theory", "standard")
def solve_linear(context: Context) -> Outcome:
    """Press a large sphere, for strains below 1 %, into a layer so wide that its side does not matter.

    The difference to linear theory at chi = 0.25 is -0.5, -0.2 and -0.01 % for spheres of 14, 28 and 100 mm. Its causes
    are finite strain and the difference between sphere and paraboloid. Radii of 24 and 40 mm agree within 0.01 %.
    """
    sphere, size, wide = 100.0, LayerMeshSize(0.1, 1.2, 0.25, 0.1), 24.0
    depths = {chi: (chi * HEIGHT_MM) ** 2 / sphere for chi in (0.1, 0.2, 0.25)}
    radii = EDGE_RADII_MM[EDGE_RADII_MM < 2.0]
    pressed = press_layer(size, sphere, 0.0, [*depths.values()], radii, context.device, radius=wide)
    force = {chi: float(pressed.force[pressed.at(depth)]) for chi, depth in depths.items()}
    rows = []
    for chi, (over_hertz, over_root) in LINEAR.items():
        where = f"chi = {chi:g}, linear theory"
        rows.append(Row(f"force, {where}", "mN", 1e3 * force[chi], 1e3 * over_hertz * hertz_force(sphere, depths[chi]),
                        TARGET, "relative", "exact for a paraboloid, endless layer; the project's target"))  # fmt: skip
        edge = contact_radius(pressed, depths[chi], 0.01 * depths[chi])
        rows.append(Row(f"contact radius, {where}", "mm", edge, over_root * chi * HEIGHT_MM, size.edge, "absolute",
                        "the same; one element's edge"))  # fmt: skip
    for chi, own in ((0.1, "-0.2 %"), (0.2, "-1.1 %, from those at 0.1 and 0.25")):
        rows.append(Row(f"force, chi = {chi:g}, Dimitriadis", "mN", 1e3 * force[chi],
                        1e3 * dimitriadis_force(sphere, depths[chi]), TARGET, "relative",
                        f"Dimitriadis 2002, eq. 12, nu = 0.5 (+0.2 %); its own error {own}"))  # fmt: skip
    return Outcome(rows, notes=[f"chi = sqrt(R d) / h; R = {sphere:g} mm, h = {HEIGHT_MM:g} mm, layer of radius "
                                f"{wide:g} mm, {pressed.unknowns} unknowns, nu = 0.499"])  # fmt: skip
