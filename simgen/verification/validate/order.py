"""Cases on orders of convergence: a manufactured solution, and curved against straight elements.

Lengths in mm, stresses in units of Young's modulus (E = 1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from simgen.fem.elements.element import P2P1, tet_geometry
from simgen.verification.validate.case import Context, Curve, Outcome, Row, Table, case
from simgen.verification.validate.equilibrium import body_load, make_body, solve, surface_load, volume_points
from simgen.verification.validate.exact import RADII, inflate
from simgen.verification.validate.inflation import compressible
from simgen.verification.validate.meshes import box, on_plane, perturbed, sphere_shell, top
from simgen.verification.validate.reference_law import ReferenceLaw


@dataclass(frozen=True)
class Manufactured:
    """Three simple shears that vary in space, one after the other, and a change of volume on top.

    x = X + a sin(kY), y = Y + a sin(kZ), z = Z + a sin(kx), then x + v/k sin(kx): det F = 1 + v cos(kx) exactly, so
    that a nearly incompressible body has pressures of the size of its shear stresses. Points may be complex.
    """

    wave: float  # k, 1/mm
    shear: float  # a k
    volume: float  # v

    def _sheared(self, points: np.ndarray) -> np.ndarray:
        X, Y, Z = np.moveaxis(points, -1, 0)
        a, k = self.shear / self.wave, self.wave
        x = X + a * np.sin(k * Y)
        return np.stack([x, Y + a * np.sin(k * Z), Z + a * np.sin(k * x)], axis=-1)

    def displacement(self, points: np.ndarray) -> np.ndarray:
        moved = self._sheared(points)
        moved[..., 0] += self.volume / self.wave * np.sin(self.wave * moved[..., 0])
        return moved - points

    def gradient(self, points: np.ndarray) -> np.ndarray:
        """F (..., 3, 3)."""
        x = self._sheared(points)[..., 0]
        first, second, third = (np.zeros((*points.shape, 3), dtype=points.dtype) + np.eye(3) for _ in range(3))
        first[..., 0, 1] = self.shear * np.cos(self.wave * points[..., 1])
        first[..., 1, 2] = self.shear * np.cos(self.wave * points[..., 2])
        second[..., 2, 0] = self.shear * np.cos(self.wave * x)
        third[..., 0, 0] = self.volume_ratio(points)
        return third @ second @ first

    def volume_ratio(self, points: np.ndarray) -> np.ndarray:
        """det F."""
        return 1.0 + self.volume * np.cos(self.wave * self._sheared(points)[..., 0])


@dataclass(frozen=True)
class OrderErrors:
    """Relative errors: L2 of the displacement, L2 of its gradient, L2 of the pressure; h is the edge of a cell, mm."""

    h: float
    displacement: float
    gradient: float
    pressure: float


def manufactured_errors(field: Manufactured, nu: float, cells: int, device: str) -> OrderErrors:
    """Solve on a cube of ``cells`` per edge: displacements given on all sides but the top, which carries tractions."""
    edge = 2.0
    h = edge / cells
    mesh = perturbed(box((cells,) * 3, (edge,) * 3), shift=0.12 * h, bend=0.0, inside_only=True)
    law = ReferenceLaw(nu)
    body = make_body(mesh, law, device)
    fixed = np.zeros(mesh.nodes.shape, dtype=bool)
    loaded = top(mesh.nodes, mesh.faces)
    fixed[np.setdiff1d(mesh.faces, loaded)] = True
    fixed[np.intersect1d(loaded, mesh.faces[~on_plane(mesh.nodes, 1, 0.0)[mesh.faces].all(axis=1)])] = True
    loads = body_load(mesh, lambda points: law.body_force(field.gradient, points))
    loads += surface_load(mesh, loaded, lambda points: law.first_piola(field.gradient(points)))
    found = solve(body, fixed, field.displacement(mesh.nodes), loads, out_of_balance=1e-10)

    points = volume_points(mesh)
    tets = mesh.tetrahedra
    u = np.einsum("qa,eai->eqi", points.shapes, found.displacement[tets])
    gradient = np.einsum("eai,eqaj->eqij", found.displacement[tets], points.gradients)
    p = found.pressure[tets[:, :4]] @ points.pressure_shapes.T
    exact_p = (law.lam - body.material.gamma) * (field.volume_ratio(points.positions) - 1.0)

    def relative(ours: np.ndarray, exact: np.ndarray) -> float:
        squared = [points.volumes * (values**2).reshape(*points.volumes.shape, -1).sum(axis=-1)
                   for values in (ours - exact, exact)]  # fmt: skip
        return float(np.sqrt(squared[0].sum() / squared[1].sum()))

    return OrderErrors(
        h,
        relative(u, field.displacement(points.positions)),
        relative(gradient, field.gradient(points.positions) - np.eye(3)),
        relative(p, exact_p),
    )


def order(sizes: list[float], errors: list[float]) -> float:
    """Least-squares slope of log error over log size."""
    return float(np.polyfit(np.log(sizes), np.log(np.abs(errors)), 1)[0])


def slope_line(plot: str, sizes: list[float], last_error: float, power: int, labels: tuple[str, str]) -> Curve:
    """A dashed line of the given order through the last error."""
    line = [last_error * (size / sizes[-1]) ** power for size in sizes]
    return Curve(plot, f"order {power}", sizes, line, *labels, log=True, style="dashed")


@case("order-manufactured", "Order of convergence: a manufactured solution at finite strain", "quick")
def manufactured(context: Context) -> Outcome:
    nu, field = 0.499, Manufactured(wave=1.5, shear=0.4, volume=2e-3)
    found = [manufactured_errors(field, nu, cells, context.device) for cells in (3, 4, 6, 8)]
    sizes = [errors.h for errors in found]
    rows, curves = [], []
    labels = ("edge of a cell, mm", "relative error")
    for name, what, least, theory in (("displacement", "displacement, L2", 2.8, 3),
                                      ("gradient", "displacement, H1", 1.9, 2),
                                      ("pressure", "pressure, L2", 1.8, 2)):  # fmt: skip
        errors = [getattr(each, name) for each in found]
        rows.append(Row(f"order of the {what}", "", order(sizes, errors), math.nan, least, "at least",
                        f"the project's target; in theory {theory} (Boffi, Brezzi and Fortin 2013)"))  # fmt: skip
        curves.append(Curve(what, "ours", sizes, errors, *labels, log=True, style="points"))
        curves.append(slope_line(what, sizes, errors[-1], theory, labels))
    columns = ["edge of a cell, mm", "displacement, L2", "displacement, H1", "pressure, L2"]
    table = Table("Relative errors", columns, [[e.h, e.displacement, e.gradient, e.pressure] for e in found])
    return Outcome(rows, [table], curves, [
        f"nu = {nu}; shears of up to {field.shear:.0%} in three planes; irregular meshes of a cube of 2 mm; body force "
        "and tractions from the first Piola stress, differentiated by complex steps; orders by least squares.",
    ])  # fmt: skip


@case("order-curved", "Curved against straight elements: inflation of a thick-walled sphere", "quick")
def curved(context: Context) -> Outcome:
    law, stretch, counts = ReferenceLaw(0.499), 1.3, (2, 3, 4, 6)
    exact, volume = compressible(law, RADII, stretch), math.pi / 6.0 * (RADII[1] ** 3 - RADII[0] ** 3)
    sizes = [RADII[0] / count for count in counts]
    labels = ("1 / edges along a quarter circle", "relative error")
    table = Table("Relative errors", ["elements", "edges along a quarter circle", "cavity pressure", "outer radius",
                                      "volume at rest"], [])  # fmt: skip
    pressure, curves = {}, []
    for kind in ("straight", "curved"):
        errors = []
        for count in counts:
            mesh = sphere_shell(count, count, RADII, straight=kind == "straight")
            found = inflate(mesh, law, stretch, context.device, steps=2)
            rest = tet_geometry(P2P1, mesh.nodes, mesh.tetrahedra).volumes.sum() / volume - 1.0
            errors.append((found.pressure / exact.pressure - 1.0, found.outer_radius / exact.outer_radius - 1.0, rest))
            table.rows.append([kind, str(count), *errors[-1]])
        pressure[kind] = [abs(error[0]) for error in errors]
        curves.append(Curve("cavity pressure", kind, sizes, pressure[kind], *labels, log=True, style="points"))
        curves.append(slope_line("cavity pressure", sizes, pressure[kind][-1], 2 if kind == "straight" else 4, labels))
    theory = "quadratic elements on a boundary met to third order, or to first (Strang and Fix 1973, section 4.4)"
    better = pressure["straight"][-1] / pressure["curved"][-1]
    rows = [
        Row("order of the cavity pressure, curved", "", order(sizes[1:], pressure["curved"][1:]), math.nan, 3.5,
            "at least", f"in theory 4: {theory}"),
        Row("order of the cavity pressure, straight", "", order(sizes[1:], pressure["straight"][1:]), 2.0, 0.3,
            "absolute", theory),
        Row("error on the finest mesh, straight by curved", "", better, math.nan, 10.0, "at least",
            "more than one refinement of straight elements, a factor of 4"),
    ]  # fmt: skip
    note = f"{law}, cavity {stretch:g} times as wide; reference: the radial problem of our own law."
    return Outcome(rows, [table], curves, [note])
