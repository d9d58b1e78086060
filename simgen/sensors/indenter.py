"""Indenters: the strict table of analytic shapes, users' own closed meshes, and their signed distances.

A `RigidShape` is in mm in the indenter frame (tip plane y = 0, press direction +y, body towards -y). Meshes are in m.
"""

import hashlib
import os
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal, get_args

import numpy as np
import trimesh
from pydantic import Field

from simgen.config.choices import MESH_SPACING_MM
from simgen.config.job_schema import Job
from simgen.config.parsing import parsing
from simgen.config.resources import resource
from simgen.config.strict_section import StrictSection, section_from_dict
from simgen.config.yaml_files import read_yaml
from simgen.errors import InputError, shown
from simgen.geometry.mesh_files import LARGEST, SMALLEST, UNITS, check_mesh
from simgen.geometry.rigid_shape import (
    MOST_GRID_POINTS,
    grid_counts,
    mesh_distance,
    rigid_shape,
    sampled_shape,
    shape_array,
    signed_distance,
)
from simgen.geometry.signed_distance import Kind, Probe, RigidShape, probe
from simgen.units import MM_PER_M

__all__ = [
    "Indenter", "Kind", "Probe", "RigidShape", "indenter_names", "load_indenter", "mesh_distance", "probe",
    "rigid_shape", "sampled_shape", "shape_array", "signed_distance",
]  # fmt: skip

MESH_SUFFIXES = (".stl", ".obj", ".ply")
MARGIN_MM = 3.0  # of a mesh's grid around the mesh
DRAWN_LENGTH = 0.010  # m, drawn part of an endless shaft

Length = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]


class SphereSpec(StrictSection):
    kind: Literal["sphere"]
    radius_mm: Length


class CylinderSpec(StrictSection):
    kind: Literal["cylinder"]
    radius_mm: Length
    half_length_mm: Length
    fillet_mm: Length


class CubeSpec(StrictSection):
    kind: Literal["cube"]
    half_width_mm: Length
    fillet_mm: Length


class RingSpec(StrictSection):
    kind: Literal["ring"]
    outer_radius_mm: Length
    hole_radius_mm: Length
    fillet_mm: Length


class TextureSpec(StrictSection):
    kind: Literal["texture"]
    half_width_mm: Length
    fillet_mm: Length
    bump_radius_mm: Length
    bump_offset_mm: Length


class MeshSpec(StrictSection):
    kind: Literal["mesh"]
    file: str
    unit: Literal["m", "mm"] = "m"
    spacing_mm: Length = MESH_SPACING_MM


Spec = SphereSpec | CylinderSpec | CubeSpec | RingSpec | TextureSpec | MeshSpec
SPECS: dict[str, type[StrictSection]] = {
    get_args(spec.model_fields["kind"].annotation)[0]: spec for spec in get_args(Spec)
}


@dataclass(frozen=True)
class Indenter:
    """A named indenter. Analytic indenters have neither ``source`` nor ``sha256``."""

    name: str
    spec: Spec
    source: trimesh.Trimesh | None = None  # a user's own mesh, m
    sha256: str | None = None  # of its file

    def shape(self) -> RigidShape:
        """Shape for `probe`, on the CPU (`shape_array` moves shapes to a device)."""
        if isinstance(self.spec, MeshSpec):
            return _sampled(self.source, self.spec.spacing_mm)
        return rigid_shape(Kind[self.spec.kind.upper()], *(v for k, v in self.spec if k != "kind"))

    def identity(self) -> dict[str, str | float]:
        """Everything that defines the shape: sizes, or unit, grid spacing and sha256 of a mesh file."""
        own = {} if self.sha256 is None else {"sha256": self.sha256}
        return self.spec.model_dump(exclude={"file"}) | own

    def mesh(self) -> trimesh.Trimesh:
        """Closed surface for drawing, m; analytic shapes are cut at least 10 mm behind the tip."""
        return self.source if self.source is not None else _draw(self)

    @property
    def extent(self) -> np.ndarray:
        """Bounding box (2, 3) of `mesh`, m."""
        if self.source is not None:
            return np.array(self.source.bounds)
        return _extent_mm(self.spec) / MM_PER_M


@lru_cache(maxsize=4)
def _sampled(source: trimesh.Trimesh, spacing_mm: float) -> RigidShape:
    """Sample a mesh, which takes seconds: checks of contacts and presses need the same shape."""
    return sampled_shape(source, spacing_mm, MARGIN_MM)


def indenter_names(file: str | Path | None = None) -> list[str]:
    """Names in an indenter table, in its order; by default the nine of the package."""
    return list(_read_table(_table_path(file)))


def chosen_indenters(job: Job) -> list[Indenter]:
    """Load the indenters of a job, in its order. Raises InputError like `load_indenter`."""
    return [chosen_indenter(job, index) for index in range(len(job.indenters))]


def chosen_indenter(job: Job, index: int) -> Indenter:
    """Load one indenter of a job. Raises InputError like `load_indenter`."""
    choice = job.indenters[index]
    return load_indenter(job.locate(choice.file), unit=choice.unit, spacing_mm=choice.spacing_mm)


def load_indenter(
    name_or_path: str | Path,
    file: str | Path | None = None,
    unit: Literal["m", "mm"] = "m",
    spacing_mm: float = MESH_SPACING_MM,
) -> Indenter:
    """Load an indenter by its name in a table, or a closed mesh (.stl .obj .ply) by its path.

    ``file`` is the table, by default the package's ``indenters.yaml``. ``unit`` and ``spacing_mm`` apply to a mesh.
    Raises InputError for an unknown name, a bad table, and a mesh that is not closed or cannot be sampled.
    """
    name = str(name_or_path)
    if Path(name).suffix.lower() in MESH_SUFFIXES:
        spec = MeshSpec(kind="mesh", file=name, unit=unit, spacing_mm=spacing_mm)
        return _mesh_indenter(Path(name).stem, spec, Path(name))
    path = _table_path(file)
    table = _read_table(path)
    if name not in table:
        raise InputError(f"{path}: no indenter '{name}'; allowed: {', '.join(table)}, or a mesh (.stl .obj .ply)")
    spec = table[name]
    if isinstance(spec, MeshSpec):
        return _mesh_indenter(name, spec, path.parent / spec.file)
    return Indenter(name, spec)


def _mesh_indenter(name: str, spec: MeshSpec, file: Path) -> Indenter:
    mesh = _read_mesh(file)
    _check_reading(file, np.asarray(mesh.extents), spec)
    mesh.apply_scale(UNITS[spec.unit])
    return Indenter(name, spec, mesh, hashlib.sha256(file.read_bytes()).hexdigest())


def _table_path(file: str | Path | None) -> Path:
    return resource("indenters") / "indenters.yaml" if file is None else Path(file)


def _read_table(path: Path) -> dict[str, Spec]:
    entries, table = read_yaml(path), {}
    if not isinstance(entries, dict):
        raise InputError(f"{path}: not a mapping of names to indenters")
    for name, entry in entries.items():
        kind = entry.get("kind") if isinstance(entry, dict) else None
        if not isinstance(kind, str) or kind not in SPECS:
            raise InputError(f"{path}: {name}.kind: {shown(repr(kind))}; allowed: {', '.join(SPECS)}")
        table[name] = section_from_dict(SPECS[kind], entry, f"{path}: {name}")
    for name, spec in table.items():
        _check_sizes(path, name, spec)
    return table


def _check_sizes(path: Path, name: str, spec: Spec) -> None:
    """Raise InputError for a fillet that is too large for its shape, or a ring without a wall."""
    if isinstance(spec, RingSpec):
        if spec.hole_radius_mm >= spec.outer_radius_mm:
            raise InputError(
                f"{path}: {name}.hole_radius_mm: {spec.hole_radius_mm:g}; allowed: less than outer_radius_mm "
                f"({spec.outer_radius_mm:g})"
            )
        room = 0.5 * (spec.outer_radius_mm - spec.hole_radius_mm)
    elif isinstance(spec, CylinderSpec):
        room = min(spec.radius_mm, spec.half_length_mm)
    elif isinstance(spec, CubeSpec | TextureSpec):
        room = spec.half_width_mm
    else:
        return
    if spec.fillet_mm > room:
        raise InputError(f"{path}: {name}.fillet_mm: {spec.fillet_mm:g}; allowed: 0 < fillet_mm <= {room:g}")


def _check_reading(path: Path, extents: np.ndarray, spec: MeshSpec) -> None:
    """Raise InputError if extents (3,), in the file's numbers, are too small or too large in the given unit.

    The unit is never guessed, but the error line names the other unit if the mesh would fit in it.
    """
    complaint = _misfit(UNITS[spec.unit] * extents, spec.spacing_mm)
    if complaint is None:
        return
    (other,) = UNITS.keys() - {spec.unit}
    if _misfit(UNITS[other] * extents, spec.spacing_mm) is None:
        complaint += f"; its unit is probably {other}: {{file: {path.name}, unit: {other}}}"
    raise InputError(f"{path}: {complaint}")


def _misfit(extents_m: np.ndarray, spacing_mm: float) -> str | None:
    """Reason why a mesh is too small, or too large for its grid; None if it is neither."""
    size = f"the shape is {extents_m.max():g} m large"
    if not SMALLEST < extents_m.max() < LARGEST:
        return f"{size}; allowed: {SMALLEST:g}..{LARGEST:g} m"
    points = grid_counts(extents_m, spacing_mm, MARGIN_MM).prod()
    if points > MOST_GRID_POINTS:
        return f"{size}, spacing_mm: {spacing_mm:g} makes {points:.2g} grid points; allowed: {MOST_GRID_POINTS:.2g}"
    return None


def _read_mesh(path: Path) -> trimesh.Trimesh:
    """Read a closed surface with outward normals, in the numbers of its file."""
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise InputError(f"{path}: not a mesh format for an indenter; allowed: {' '.join(MESH_SUFFIXES)}")
    if not os.path.isfile(path):  # no OSError for a name that is too long
        raise InputError(f"{path}: no such file; an indenter's mesh is a closed surface (.stl .obj .ply)")
    with parsing(path, "a surface mesh"):
        mesh = trimesh.load(path, force="mesh")
        check_mesh(path, mesh.vertices, mesh.faces)
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        if len(mesh.faces) == 0 or not mesh.is_watertight:
            raise InputError(f"{path}: the surface is not watertight; an indenter needs a closed surface")
        if not mesh.is_winding_consistent:
            mesh.fix_normals(multibody=True)
        if mesh.volume < 0.0:
            mesh.invert()
        if not mesh.volume > 0.0:
            raise InputError(f"{path}: the surface encloses no volume; an indenter needs a body")
    return mesh


def _extent_mm(spec: Spec) -> np.ndarray:
    """Bounding box (2, 3) mm of an analytic shape, cut as `Indenter.mesh` is."""
    match spec:
        case SphereSpec():
            x = z = spec.radius_mm
        case CylinderSpec():
            x, z = spec.half_length_mm, spec.radius_mm
        case RingSpec():
            x = z = spec.outer_radius_mm
        case _:
            x = z = spec.half_width_mm
    length = MM_PER_M * DRAWN_LENGTH + (spec.bump_radius_mm if isinstance(spec, TextureSpec) else 0.0)
    return np.array([[-x, -length, -z], [x, 0.0, z]])


def _draw(indenter: Indenter) -> trimesh.Trimesh:
    spec = indenter.spec
    if isinstance(spec, TextureSpec):
        base = CubeSpec(kind="cube", half_width_mm=spec.half_width_mm, fillet_mm=spec.fillet_mm)
        cube = Indenter("", base).mesh()
        cube.apply_translation([0.0, -1e-3 * spec.bump_radius_mm, 0.0])
        bump = trimesh.creation.icosphere(subdivisions=3, radius=1e-3 * spec.bump_radius_mm)
        o = spec.bump_offset_mm
        centres = np.array([(0, 0), (o, o), (o, -o), (-o, o), (-o, -o)]) * 1e-3
        bumps = [bump.copy().apply_translation([x, -1e-3 * spec.bump_radius_mm, z]) for x, z in centres]
        return trimesh.util.concatenate([cube, *bumps])
    if isinstance(spec, RingSpec):
        return _revolve(indenter.shape(), spec.hole_radius_mm, spec.outer_radius_mm)
    if isinstance(spec, SphereSpec):
        return _revolve(indenter.shape(), 0.0, spec.radius_mm)
    if isinstance(spec, CubeSpec):
        half_x = half_z = spec.half_width_mm
    else:
        half_x, half_z = spec.half_length_mm, spec.radius_mm
    # The closest-point map of an enclosing box covers a convex shape.
    box = trimesh.creation.box(extents=[2.0 * half_x, 1e3 * DRAWN_LENGTH, 2.0 * half_z])
    box = box.subdivide_to_size(0.35)
    box.apply_translation([0.0, -0.5e3 * DRAWN_LENGTH, 0.0])
    vertices = _onto(indenter.shape(), np.asarray(box.vertices))
    return trimesh.Trimesh(vertices * 1e-3, box.faces, process=False)


def _onto(shape: RigidShape, points_mm: np.ndarray) -> np.ndarray:
    """Move points outside the shape to their closest points on it."""
    distance, normal, _ = signed_distance(shape, points_mm)
    return points_mm - np.maximum(distance, 0.0)[:, None] * normal


def _revolve(shape: RigidShape, inner: float, outer: float) -> trimesh.Trimesh:
    """Shape of revolution about y between two radii (mm): a solid or a tube, cut at the drawn length."""
    length = 1e3 * DRAWN_LENGTH
    heights = -np.linspace(0.0, length, 101)[1:]
    zero = np.zeros(100)
    wall = np.column_stack([np.full(100, outer), heights, zero])[::-1]
    rim = np.column_stack([np.linspace(outer, inner, 41), np.zeros((41, 2))])
    bore = np.column_stack([np.full(100, inner), heights, zero])
    if inner > 0.0:
        profile = _onto(shape, np.vstack([wall, rim, bore, wall[:1]]))
    else:
        profile = np.vstack([[[0.0, -length, 0.0]], _onto(shape, np.vstack([wall, rim]))])
    mesh = trimesh.creation.revolve(profile[:, :2], sections=96).apply_scale(1e-3)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [1.0, 0.0, 0.0]))
    if mesh.volume < 0.0:
        mesh.invert()
    return mesh
