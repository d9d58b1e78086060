"""A rigid sphere on a bonded, nearly incompressible layer, against an independent axisymmetric code and linear theory.

The layer: a cylinder of radius 10 mm and height 4 mm, its bottom held, E = 0.539 MPa, nu = 0.499. The reference was
computed with NGSolve 6.2.2608 (axisymmetric, order 3 without friction, edges of 0.1 mm; CalculiX 2.20 agrees within
0.1 % without and 0.7 % with friction). Here the layer is three-dimensional: a quarter between two planes of symmetry,
on two meshes. Its forces and contact radii stand below; displacements of the surface come from the reference's
``axisymmetric/profile.csv`` and are left out where that folder is not given.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simgen.distance import Kind
from simgen.press import PressResult, Scene, SolverSettings, Status, press
from simgen.sensor import Material
from simgen.shape import rigid_shape, signed_distance

from .case import Context, Curve, Outcome, Row, Table, case
from .layer_meshes import graded, make_sensor, round_layer
from .meshes import on_plane, top

RADIUS_MM, HEIGHT_MM = 10.0, 4.0
MODULUS_MPA, POISSON_RATIO = 0.539, 0.499
UM, MM, PERCENT = 1e6, 1e3, 0.01
QUARTERS = 4  # of the whole layer: forces on one quarter count so often
MOVED_MM = 0.01  # the deformation region: what has moved this far
APART_MM = 0.003  # a surface further than this from the sphere has left it: a few times the pointwise overlap
AZIMUTHS = np.radians([0.0, 22.5, 45.0, 67.5, 90.0])
SEGMENTS = 4  # of a ring's quarter
STEP_MM = 0.1
FINE_RADII_MM = np.arange(0.0, 6.0, 0.02)  # where the contact's edge is looked for


@dataclass(frozen=True)
class Reference:
    """By depth, mm: force, N, and radius of the contact circle, mm; pressure per rest area at 2 mm in its centre, MPa.

    ``steps``: load steps to 2 mm.
    """

    steps: int
    force: tuple[float, ...]
    contact_radius: tuple[float, ...]
    pressure: float


DEPTHS_MM = (0.1, 0.25, 0.5, 1.0, 1.5, 2.0)
# Sphere's radius (mm), friction. With friction the reference falls as its load steps get finer (R = 3.5 mm, 0.78: by
# 0.7 % at 1 mm and 0.95 % at 2 mm from 20 to 160 steps); the finest that there is.
REFERENCES = {
    (1.75, 0.0): Reference(20, (0.044264, 0.185391, 0.55679, 1.672366, 3.092791, 4.612096),
                           (0.4429, 0.703, 0.9962, 1.3728, 1.5981, 1.7244), 2.3641),
    (1.75, 0.78): Reference(20, (0.044558, 0.187333, 0.5702, 1.797915, 3.605549, 5.999323),
                            (0.4403, 0.6996, 0.983, 1.3392, 1.5593, 1.6833), 0.66484),
    (3.5, 0.0): Reference(20, (0.066807, 0.294911, 0.949334, 3.208069, 6.61062, 11.013194),
                          (0.6365, 1.032, 1.4958, 2.156, 2.6257, 2.9763), 1.55964),
    (3.5, 0.3): Reference(20, (0.067254, 0.297022, 0.969971, 3.442955, 7.609133, 13.759968),
                          (0.6332, 1.0282, 1.4895, 2.1326, 2.5812, 2.9209), 0.64949),
    (3.5, 0.78): Reference(160, (0.067206, 0.296393, 0.96785, 3.438513, 7.673477, 14.106639),
                           (0.635, 1.0289, 1.4911, 2.1327, 2.575, 2.9037), 0.6498),
    (7.0, 0.0): Reference(20, (0.103716, 0.491059, 1.727815, 6.564298, 14.680614, 26.273367),
                          (0.9208, 1.5244, 2.2561, 3.3169, 4.117, 4.7522), 1.6007),
}  # fmt: skip


@dataclass(frozen=True)
class MeshSize:
    """Edges, mm: ``edge`` under the contact, ``growth`` more per mm beyond ``until``; ``top`` of the first layer."""

    edge: float
    until: float
    growth: float
    top: float

    def coarser(self, factor: float) -> MeshSize:
        return MeshSize(factor * self.edge, self.until, factor * self.growth, factor * self.top)


SIZES = {1.75: MeshSize(0.15, 0.5, 0.15, 0.2), 3.5: MeshSize(0.2, 0.7, 0.1, 0.22), 7.0: MeshSize(0.3, 1.0, 0.1, 0.3)}
COARSER = 1.5
# Multipliers settle the faster the stiffer the contact is beside an element, whose stiffness goes with E / edge.
STIFFNESS_PER_MM = {1.75: 200.0, 3.5: 60.0, 7.0: 60.0}


@dataclass(frozen=True)
class Pressed:
    """One press on one mesh; d depths, p radii.

    force (d,) N of the whole layer; displacement (d, azimuths, p, 3) mm: radial, along the axis, around it
    rings (r,) mm: rest radii of the rings; pressure (r, azimuths of the ring) MPa per rest area, at the last depth
    """

    unknowns: int
    depths: np.ndarray
    radii: np.ndarray
    force: np.ndarray
    displacement: np.ndarray
    rings: np.ndarray
    pressure: list[np.ndarray]
    result: PressResult


def quarter_layer(size: MeshSize, radii_mm: np.ndarray, radius_mm: float = RADIUS_MM):
    """A sensor: the layer's quarter, whose output are surface points at all radii (mm) and `AZIMUTHS`."""
    levels = graded(HEIGHT_MM, size.top, size.top, 0.25)
    mesh = round_layer(graded(radius_mm, size.edge, size.until, size.growth), levels, SEGMENTS)
    held = np.stack([on_plane(mesh.nodes, axis, 0.0) & (axis != 1) for axis in range(3)], axis=1)
    held[on_plane(mesh.nodes, 1, HEIGHT_MM)] = True
    across = [np.outer(direction(AZIMUTHS), radii_mm) for direction in (np.cos, np.sin)]
    points = np.stack([across[0], np.zeros_like(across[0]), across[1]], axis=-1).reshape(-1, 3)
    return make_sensor(mesh, held, top(mesh.nodes, mesh.faces), points)


def press_layer(sensor, radii_mm, sphere_mm, friction, depths_mm, stiffness, device) -> Pressed:
    """Press a sphere to all depths (mm). Raises RuntimeError, with the reason, where it does not get there."""
    material = Material(youngs_modulus_pa=MODULUS_MPA * 1e6, poisson_ratio=POISSON_RATIO, friction=friction,
                        source="as the reference")  # fmt: skip
    settings = SolverSettings(contact_stiffness_per_mm=stiffness)
    scene = Scene(sensor, material, device=device, settings=settings)
    shape = rigid_shape(Kind.SPHERE, sphere_mm)
    result = press(scene, [shape], np.eye(4)[None], np.asarray(depths_mm) / MM)[0]
    if result.status.any():
        reached = depths_mm[int(np.flatnonzero(result.status)[0])]
        raise RuntimeError(f"not converged at {reached:g} mm: {Status(result.status[-1]).sentence}")
    moved = result.displacement.reshape(len(depths_mm), len(AZIMUTHS), len(radii_mm), 3) * MM
    cos, sin = np.cos(AZIMUTHS)[:, None], np.sin(AZIMUTHS)[:, None]
    x, y, z = np.moveaxis(moved, -1, 0)
    polar = np.stack([x * cos + z * sin, y, z * cos - x * sin], axis=-1)
    rings, pressure = ring_pressures(scene)
    force = QUARTERS * result.force[:, 1]
    return Pressed(scene.unknowns, np.asarray(depths_mm), radii_mm, force, polar, rings, pressure, result)


def ring_pressures(scene: Scene) -> tuple[np.ndarray, list[np.ndarray]]:
    """Contact multipliers at the end of a press, MPa, for each ring of corner nodes: rest radii (mm) and values."""
    contact = scene.indenter_contact
    corners = scene.nodes[np.unique(contact.host_faces[:, :3])]  # the order of the multipliers
    values = contact.surface.normal.numpy()[:, 0] * MODULUS_MPA
    radius, ring = np.unique(np.hypot(corners[:, 0], corners[:, 2]).round(6), return_inverse=True)
    return radius, [values[ring == i] for i in range(len(radius))]


def contact_radius(pressed: Pressed, depth: int, sphere_mm: float) -> float:
    """Deformed radius, mm, up to which the surface (mean over the azimuths) lies within `APART_MM` of the sphere."""
    fine = pressed.radii <= FINE_RADII_MM[-1]
    u = pressed.displacement[depth][:, fine]
    radius = pressed.radii[fine] + u[..., 0]
    points = np.stack([radius, u[..., 1] - pressed.depths[depth], u[..., 2]], axis=-1)
    gap = signed_distance(rigid_shape(Kind.SPHERE, sphere_mm), points.reshape(-1, 3))[0].reshape(radius.shape)
    touching = gap.mean(axis=0) <= APART_MM
    return float(radius.mean(axis=0)[touching].max())


def surface_error(pressed: Pressed, depth: int, profile: np.ndarray) -> float:
    """Root mean square, mm, over the deformation region of the difference to a profile (k, 3): r, u_r, u_y in mm.

    Each radius weighs as the annulus between the middles to its neighbours; all azimuths weigh the same, and a
    displacement around the axis is all error.
    """
    r, expected = profile[:, 0], np.insert(profile[:, 1:], 2, 0.0, axis=1)
    ours = pressed.displacement[depth][:, np.searchsorted(pressed.radii, r - 1e-9)]
    edges = np.concatenate([[0.0], 0.5 * (r[1:] + r[:-1]), r[-1:]])
    moved = np.linalg.norm(expected, axis=1) >= MOVED_MM
    weight = np.where(moved, np.diff(edges**2), 0.0)
    squared = ((ours - expected) ** 2).sum(axis=-1).mean(axis=0)
    return float(np.sqrt((weight * squared).sum() / weight.sum()))


def read_profiles(reference: Path | None, sphere_mm: float, friction: float) -> dict[float, np.ndarray]:
    """Surface of the reference by depth, (k, 3): rest radius, u_r, u_y (into the layer) in mm; empty without a file."""
    path = None if reference is None else reference / "axisymmetric" / "profile.csv"
    if path is None or not path.is_file():
        return {}
    profiles: dict[float, list] = {}
    with path.open(newline="") as table:
        for row in csv.DictReader(table):
            if (float(row["sphere_radius_mm"]), float(row["friction"])) == (sphere_mm, friction):
                values = float(row["r_mm"]), float(row["u_r_mm"]), -float(row["u_z_mm"])
                profiles.setdefault(float(row["depth_mm"]), []).append(values)
    return {depth: np.array(rows) for depth, rows in profiles.items()}


def output_radii(profiles: dict[float, np.ndarray]) -> np.ndarray:
    return np.unique(np.concatenate([FINE_RADII_MM, *(profile[:, 0] for profile in profiles.values())]).round(9))


def increments(deepest_mm: float) -> np.ndarray:
    """Depths in steps of `STEP_MM`, and those of the reference in between."""
    steps = np.arange(1, round(deepest_mm / STEP_MM) + 1) * STEP_MM
    return np.unique(np.concatenate([steps, [d for d in DEPTHS_MM if d <= deepest_mm]]).round(9))


def named(sphere_mm: float, friction: float) -> str:
    return f"R = {sphere_mm:g} mm, " + (f"friction {friction:g}" if friction else "frictionless")


def origin_of(reference: Reference, friction: float) -> str:
    return f"NGSolve, axisymmetric, {reference.steps} load steps" if friction else "NGSolve, axisymmetric"


def reference_rows(pressed: Pressed, sphere_mm, friction, edge_mm, profiles, depths_mm) -> list[Row]:
    """Force, contact radius and surface against the reference, at each of its depths."""
    reference, what = REFERENCES[sphere_mm, friction], named(sphere_mm, friction)
    origin = origin_of(reference, friction)
    rows = []
    for at, depth in enumerate(DEPTHS_MM):
        if depth not in depths_mm:
            continue
        i = int(np.abs(pressed.depths - depth).argmin())
        where = f"at {depth:g} mm, {what}"
        rows.append(Row(f"force {where}", "N", float(pressed.force[i]), reference.force[at], PERCENT, "relative",
                        f"{origin}; the project's target"))  # fmt: skip
        rows.append(Row(f"contact radius {where}", "mm", contact_radius(pressed, i, sphere_mm),
                        reference.contact_radius[at], edge_mm, "absolute", f"{origin}; the finest edge"))  # fmt: skip
        if depth in profiles:
            error = MM * surface_error(pressed, i, profiles[depth])
            rows.append(Row(f"surface displacement RMSE {where}", "um", error, np.nan, 5.0, "at most",
                            f"{origin}; the project's target, weighted by area"))  # fmt: skip
    return rows


def two_mesh_rows(fine: Pressed, coarse: Pressed, sphere_mm: float, friction: float) -> list[Row]:
    """What oscillating multipliers would break: equal around each ring, equal on both meshes, less overlap."""
    reference, what = REFERENCES[sphere_mm, friction], named(sphere_mm, friction)
    deepest = f"at {fine.depths[-1]:g} mm, {what}"
    centre = fine.pressure[0].mean()
    swing = max(np.ptp(values) for values in fine.pressure) / centre
    inside = coarse.rings < 0.8 * fine.rings[[values.mean() > 0.0 for values in fine.pressure]].max()
    means = [np.array([values.mean() for values in pressed.pressure]) for pressed in (fine, coarse)]
    other = np.interp(coarse.rings, fine.rings, means[0])
    apart = np.abs(means[1] - other)[inside].max() / centre
    overlap = [pressed.result.certificate["rms_penetration_m"][-1] * UM for pressed in (fine, coarse)]
    scatter = "the reference's orders 2 and 3 differ by 5 %"
    return [
        Row(f"force {deepest}, edges x {COARSER:g}", "N", float(coarse.force[-1]), reference.force[-1], PERCENT,
            "relative", f"{origin_of(reference, friction)}; the project's target"),
        Row(f"pressure in the centre {deepest}", "MPa", float(centre), reference.pressure, 0.05, "relative", scatter),
        Row(f"pressure, swing around a ring {deepest}", "of centre", float(swing), np.nan, 0.05, "at most",
            f"none by symmetry; {scatter}"),
        Row(f"pressure, edges x {COARSER:g} against fine {deepest}", "of centre", float(apart), np.nan, 0.05, "at most",
            scatter),
        Row(f"overlap rms {deepest}", "um", overlap[0], np.nan, overlap[1], "at most",
            f"that with edges x {COARSER:g}"),
    ]  # fmt: skip


def evidence(meshes: dict[str, Pressed], sphere_mm, friction, profiles) -> tuple[Table, list[Curve]]:
    """Cost and error of each mesh; force, surface and pressure as curves."""
    reference, what = REFERENCES[sphere_mm, friction], named(sphere_mm, friction)
    rows, curves = [], []
    for name, p in meshes.items():
        at = [int(np.abs(p.depths - depth).argmin()) for depth in DEPTHS_MM]
        errors = [f"{100.0 * (p.force[i] / f - 1.0):+.2f}" for i, f in zip(at, reference.force, strict=True)]
        c = p.result.certificate
        iterations, substeps = (int(c[key].sum()) for key in ("newton_iterations", "substeps"))
        overlap, det = float(c["rms_penetration_m"].max() * UM), float(c["min_det_F"].min())
        rows.append([name, p.unknowns, iterations, substeps, overlap, det, " ".join(errors)])
        curves.append(Curve(f"force, {what}", name, [*p.depths], [*p.force], "depth, mm", "force, N"))
        means = [float(values.mean()) for values in p.pressure]
        shown = p.rings < 1.3 * reference.contact_radius[-1]
        curves.append(Curve(f"contact pressure at 2 mm, {what}", name, [*p.rings[shown]], [*np.array(means)[shown]],
                            "rest radius, mm", "pressure per rest area, MPa"))  # fmt: skip
    curves.append(Curve(f"force, {what}", "NGSolve", [*DEPTHS_MM], [*reference.force], "depth, mm", "force, N",
                        style="points"))  # fmt: skip
    for depth, profile in profiles.items():
        p = meshes["fine"]
        i = int(np.abs(p.depths - depth).argmin())
        plot, axes = f"surface, {what}", ("rest radius, mm", "displacement into the layer, mm")
        curves.append(Curve(plot, f"{depth:g} mm", [*p.radii], [*p.displacement[i, :, :, 1].mean(axis=0)], *axes))
        curves.append(Curve(plot, f"{depth:g} mm, NGSolve", [*profile[:, 0]], [*profile[:, 2]], *axes, style="points"))
    columns = ["mesh", "unknowns", "Newton iterations", "increments", "overlap rms, um", "least det F",
               "force error, %, at " + ", ".join(f"{d:g}" for d in DEPTHS_MM) + " mm"]  # fmt: skip
    return Table(f"Bonded layer, {what}: the two meshes", columns, rows), curves


def solve_layer(context: Context, sphere_mm: float, friction: float) -> Outcome:
    """One sphere and friction on two meshes, to 2 mm."""
    profiles = read_profiles(context.reference, sphere_mm, friction)
    radii, size = output_radii(profiles), SIZES[sphere_mm]
    meshes = {}
    for name, edges in (("fine", size), (f"edges x {COARSER:g}", size.coarser(COARSER))):
        sensor = quarter_layer(edges, radii)
        stiffness = STIFFNESS_PER_MM[sphere_mm]
        meshes[name] = press_layer(sensor, radii, sphere_mm, friction, increments(2.0), stiffness, context.device)
    fine, coarse = meshes.values()
    rows = reference_rows(fine, sphere_mm, friction, size.edge, profiles, DEPTHS_MM)
    rows += two_mesh_rows(fine, coarse, sphere_mm, friction)
    table, curves = evidence(meshes, sphere_mm, friction, profiles)
    return Outcome(rows, [table], curves, without_profiles(profiles))


def without_profiles(profiles: dict) -> list[str]:
    return [] if profiles else ["no profile of the surface to compare with: see $SIMGEN_REFERENCE"]


def _register(sphere_mm: float, friction: float) -> None:
    name = f"layer-{sphere_mm:g}mm" + (f"-friction-{friction:g}" if friction else "")

    @case(name, f"Sphere on a bonded layer, {named(sphere_mm, friction)}, to 2 mm", "standard")
    def solve(context: Context) -> Outcome:
        return solve_layer(context, sphere_mm, friction)


for _pair in REFERENCES:
    _register(*_pair)


@case("layer-quick", "Sphere on a bonded layer, R = 3.5 mm, with and without friction, to 1 mm", "quick")
def quick(context: Context) -> Outcome:
    """The coarser mesh, where the force is still within the target."""
    sphere_mm, size = 3.5, SIZES[3.5].coarser(COARSER)
    rows, notes = [], []
    for friction in (0.0, 0.78):
        profiles = read_profiles(context.reference, sphere_mm, friction)
        radii = output_radii(profiles)
        sensor = quarter_layer(size, radii)
        pressed = press_layer(sensor, radii, sphere_mm, friction, increments(1.0), STIFFNESS_PER_MM[sphere_mm],
                              context.device)  # fmt: skip
        rows += reference_rows(pressed, sphere_mm, friction, size.edge, profiles, (0.5, 1.0))
        notes = without_profiles(profiles)
    return Outcome(rows, notes=notes)
