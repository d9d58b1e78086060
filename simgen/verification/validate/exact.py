"""Boundary value problems with closed forms. Finite elements solve all but the inflated sphere exactly.

Lengths in mm, stresses in units of Young's modulus (E = 1).
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np

from simgen.fem.elements.elasticity import Elasticity
from simgen.verification.validate.case import Context, Curve, Outcome, Row, case
from simgen.verification.validate.equilibrium import Equilibrium, make_body, solve, surface_load
from simgen.verification.validate.inflation import Inflation, compressible, incompressible, pressure_from_reactions
from simgen.verification.validate.meshes import Mesh, box, faces_on_sphere, on_plane, perturbed, sphere_shell
from simgen.verification.validate.reference_law import LAWS, YEOH, ReferenceLaw

IDENTITY = np.eye(3)
PATCH = "the project's target; the equations are solved to 1e-13 E mm2"
CUBE = 3.0  # mm, edge of the block of most cases


def block(inside_only: bool) -> Mesh:
    """A cube of irregular elements with bent edges."""
    return perturbed(box((3, 3, 3), (CUBE, CUBE, CUBE)), shift=0.15, bend=0.05, inside_only=inside_only)


def homogeneous(F: np.ndarray, mesh: Mesh) -> np.ndarray:
    """Displacement (n, 3) of the deformation x = F X."""
    return mesh.nodes @ (F - IDENTITY).T


def constant(P: np.ndarray):
    """A stress that is the same everywhere."""
    return lambda points: np.broadcast_to(P, (*points.shape[:-1], 3, 3))


def multiplier(body: Elasticity, law: ReferenceLaw, J: float) -> float:
    """Pressure unknown of a state with det F = J: the part of lam (J - 1) that is not pointwise."""
    return (law.lam - body.material.gamma) * (J - 1.0)


def patch_rows(body: Elasticity, law: ReferenceLaw, F: np.ndarray, mesh: Mesh, found: Equilibrium) -> list[Row]:
    exact, p = homogeneous(F, mesh), multiplier(body, law, float(np.linalg.det(F)))
    error = np.abs(found.displacement - exact).max() / np.abs(exact).max()
    pressure = np.abs(found.pressure - p).max() / np.abs(law.first_piola(F)).max()
    return [
        Row(f"largest error by largest displacement, {law}", "", error, math.nan, 1e-10, "at most", PATCH),
        Row(f"largest error of p by largest stress, {law}", "", pressure, math.nan, 1e-10, "at most", PATCH),
    ]


def stretch_and_shear(J: float) -> np.ndarray:
    """A deformation without symmetry, with det F = J."""
    F = IDENTITY + np.array([[0.2, 0.1, 0.0], [0.0, -0.1, 0.2], [0.1, 0.0, 0.15]])
    return F * np.cbrt(J / np.linalg.det(F))


# Law and det F. All principal stresses are tensions: compressive dead loads would turn the body over.
PATCHES = tuple(zip(LAWS, (1.3, 1.003, 1.003), strict=True))


@case("exact-patch-displacement", "Patch test: displacements on the boundary of a homogeneous deformation", "quick")
def patch_displacement(context: Context) -> Outcome:
    mesh, rows = block(inside_only=False), []
    fixed = np.zeros(mesh.nodes.shape, dtype=bool)
    fixed[mesh.faces.ravel()] = True
    for law, J in PATCHES:
        body, F = make_body(mesh, law, context.device), stretch_and_shear(J)
        displacement = np.where(fixed, homogeneous(F, mesh), 0.0)
        found = solve(body, fixed, displacement, steps=4)
        rows += patch_rows(body, law, F, mesh, found)
    return Outcome(rows, notes=["162 irregular ten-node tetrahedra, all edges bent, largest shear 20 %."])


@case("exact-patch-traction", "Patch test: tractions on the boundary of a homogeneous deformation", "quick")
def patch_traction(context: Context) -> Outcome:
    mesh, rows = block(inside_only=False), []
    fixed = hold_against_rigid_motion(mesh)
    for law, J in PATCHES:
        body, F = make_body(mesh, law, context.device), stretch_and_shear(J)
        loads = surface_load(mesh, mesh.faces, constant(law.first_piola(F)))
        displacement = np.where(fixed, homogeneous(F, mesh), 0.0)
        found = solve(body, fixed, displacement, loads, steps=4)
        rows += patch_rows(body, law, F, mesh, found)
        idle = np.abs(found.reactions).max() / np.abs(loads).max()
        rows.append(Row(f"reactions by loads, {law}", "", idle, math.nan, 1e-10, "at most", PATCH))
    return Outcome(rows, notes=["Dead tractions P N on all (bent) faces; six components of three nodes fixed."])


def hold_against_rigid_motion(mesh: Mesh) -> np.ndarray:
    """Mask (n, 3) of fixed components: all of one node, y and z of another far along x, y of a third far along z."""
    fixed = np.zeros(mesh.nodes.shape, dtype=bool)
    corners = mesh.nodes[: mesh.n_corners]
    fixed[np.argmin(corners @ [1.0, 1.0, 1.0])] = True
    fixed[np.argmax(corners @ [1.0, -0.5, -0.5]), 1:] = True
    fixed[np.argmax(corners @ [-0.5, -0.5, 1.0]), 1] = True
    return fixed


def pull(mesh: Mesh, law: ReferenceLaw, stretch: float, device: str, steps: int = 1) -> tuple[float, float]:
    """Stretch a cube along x between symmetry planes; return its nominal stress, E, and its lateral stretch."""
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    fixed = np.stack([on_plane(mesh.nodes, axis, low[axis]) for axis in range(3)], axis=1)
    end = on_plane(mesh.nodes, 0, high[0])
    fixed[end, 0] = True
    guess = np.diag([stretch, stretch**-0.5, stretch**-0.5])
    displacement = (mesh.nodes - low) @ (guess - IDENTITY)
    found = solve(make_body(mesh, law, device), fixed, displacement, steps=steps)
    side = on_plane(mesh.nodes, 1, high[1])
    return found.reactions[end, 0].sum() / CUBE**2, 1.0 + found.displacement[side, 1].mean() / CUBE


@case("exact-uniaxial", "Uniaxial tension and compression at finite strain", "quick")
def uniaxial(context: Context) -> Outcome:
    mesh, rows, curves = block(inside_only=True), [], []
    origin = "closed form of the law; as the patch"
    stretches = (0.6, 0.8, 1.3, 2.0)
    for law in LAWS:
        ours = np.array([pull(mesh, law, stretch, context.device, steps=3) for stretch in stretches])
        for i in (0, 3):
            stress, lateral = law.uniaxial(stretches[i])
            at = f"at stretch {stretches[i]:g}, {law}"
            rows.append(Row(f"nominal stress {at}", "E", ours[i, 0], stress, 1e-10, "relative", origin))
            rows.append(Row(f"lateral stretch {at}", "", ours[i, 1], lateral, 1e-10, "relative", origin))
        fine = np.linspace(stretches[0], stretches[-1], 50)
        for label, x, y, style in (("ours", stretches, ours[:, 0], "points"),
                                   ("closed form", fine, [law.uniaxial(s)[0] for s in fine], "line")):  # fmt: skip
            curves.append(Curve("uniaxial", f"{label}, {law}", [*map(float, x)], [*map(float, y)], "stretch",
                                "nominal stress, E", style=style))  # fmt: skip
    return Outcome(rows, curves=curves)


@case("exact-shear", "Simple shear at finite strain", "quick")
def simple_shear(context: Context) -> Outcome:
    mesh, rows = block(inside_only=True), []
    upper = on_plane(mesh.nodes, 1, CUBE)
    fixed = np.zeros(mesh.nodes.shape, dtype=bool)
    fixed[upper | on_plane(mesh.nodes, 1, 0.0)] = True
    free = mesh.faces[~fixed[mesh.faces].all(axis=(1, 2))]
    amount, origin = 1.0, "closed form of the law; as the patch"
    F = IDENTITY + amount * np.outer([1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    for law in LAWS:
        body, slope = make_body(mesh, law, context.device), law.slope(amount**2)
        loads = surface_load(mesh, free, constant(law.first_piola(F)))
        found = solve(body, fixed, np.where(fixed, homogeneous(F, mesh), 0.0), loads, steps=5)
        shear, normal, _ = found.reactions[upper].sum(axis=0) / CUBE**2
        error = np.abs(found.displacement - homogeneous(F, mesh)).max() / (amount * CUBE)
        at = f"at shear {amount:g}, {law}"
        rows += [
            Row(f"shear stress {at}", "E", shear, slope * amount, 1e-10, "relative", origin),
            Row(f"normal stress {at}", "E", normal, slope - law.mu, 1e-10, "absolute", origin),
            Row(f"largest error of the displacement {at}", "", error, math.nan, 1e-10, "at most", PATCH),
        ]
    return Outcome(rows, notes=["Top and bottom are displaced, the sides carry the dead tractions of simple shear."])


RADII = (1.0, 2.0)


def inflate(mesh: Mesh, law: ReferenceLaw, inner_stretch: float, device: str, steps: int = 4) -> Inflation:
    """Widen the cavity of an octant of a sphere; return pressure inside and mean radius of the outer corner nodes."""
    inner, outer = (np.unique(faces_on_sphere(mesh, radius)) for radius in RADII)
    fixed = np.stack([on_plane(mesh.nodes, axis, 0.0) for axis in range(3)], axis=1)
    fixed[inner] = True
    radius = np.linalg.norm(mesh.nodes, axis=1)
    moved = np.cbrt(radius**3 + RADII[0] ** 3 * (inner_stretch**3 - 1.0))  # first guess: incompressible
    displacement = (moved / radius - 1.0)[:, None] * mesh.nodes
    displacement[inner] = (inner_stretch - 1.0) * mesh.nodes[inner]
    found = solve(make_body(mesh, law, device), fixed, displacement, steps=steps)
    corners = outer[outer < mesh.n_corners]
    outside = np.linalg.norm((mesh.nodes + found.displacement)[corners], axis=1).mean()
    return Inflation(pressure_from_reactions(mesh, inner, found.reactions, inner_stretch), outside)


@case("exact-inflation", "Thick-walled sphere, inflated: the incompressible closed form", "quick")
def inflation(context: Context) -> Outcome:
    mesh, rows = sphere_shell(4, 4, RADII), []
    for law, stretch in product((ReferenceLaw(0.4999), replace(YEOH, poisson_ratio=0.4999)), (1.2, 1.5)):
        ours = inflate(mesh, law, stretch, context.device)
        closed, own = incompressible(law, RADII, stretch), compressible(law, RADII, stretch)
        by_law = own.pressure / closed.pressure - 1.0, own.outer_radius / closed.outer_radius - 1.0
        origin = "Green and Zerna; {:+.0e} is compressibility, the rest the mesh; "
        at = f"with the cavity {stretch:g} times as wide{', Yeoh' if law.constants else ''}"
        rows += [
            Row(f"pressure {at}", "E", ours.pressure, closed.pressure, 2e-3, "relative",
                origin.format(by_law[0]) + "a fifth of the 1 % asked of forces"),
            Row(f"outer radius {at}", "mm", ours.outer_radius, closed.outer_radius, 1e-4, "relative",
                origin.format(by_law[1]) + "0.2 um, where 5 um are asked of surfaces"),
        ]  # fmt: skip
    return Outcome(rows)
