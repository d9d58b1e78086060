"""Mesh files: users' meshes in many formats, and simgen's own .npz. Every mesh is in metres once it is read."""

import contextlib
import hashlib
import os
import tempfile
import uuid
from dataclasses import fields
from pathlib import Path

import meshio
import numpy as np
import platformdirs
import trimesh

from simgen.config.parsing import parsing
from simgen.errors import InputError
from simgen.geometry.surface import enclosed_volume
from simgen.geometry.tetrahedra import OutputMesh, SimulationMesh, boundary_triangles, signed_volumes

UNITS = {"m": 1.0, "mm": 1e-3}
SURFACE_SUFFIXES = (".stl", ".obj", ".ply")
MESHIO_FORMATS = {".msh": "gmsh", ".vtu": "vtu", ".mesh": "medit"}
TET_SUFFIXES = (*MESHIO_FORMATS, ".tet")
SMALLEST, LARGEST = 1e-4, 0.5  # m, longest side of the bounding box of a gel, a core or an indenter
FLATTEST = 1e-3  # shortest over longest side of a generated body's bounding box


def read_mesh(path: Path, unit: str) -> tuple[trimesh.Trimesh, np.ndarray | None, np.ndarray | None]:
    """Read a user's mesh: its closed outward surface, and vertices (v, 3) m and tetrahedra (t, 4).

    Vertices and tetrahedra are None for a mesh of triangles. .stl .obj .ply hold surfaces, .msh .vtu .mesh (meshio)
    tetrahedra or triangles, .tet lines ``v x y z`` and ``t a b c d``. Second-order cells are read as straight ones.

    Raises InputError if the file is missing, of an unknown format, open or has tetrahedra of both signs.
    """
    suffix = path.suffix.lower()
    if suffix not in SURFACE_SUFFIXES + TET_SUFFIXES:
        raise InputError(
            f"{path}: unknown kind of mesh {suffix!r}, allowed {' '.join(SURFACE_SUFFIXES + TET_SUFFIXES)}"
        )
    if not os.path.isfile(path):  # unlike Path.is_file, accepts a name that is too long
        raise InputError(f"{path}: no such mesh file")
    with parsing(path, suffix):
        points, cells = _read_tet(path) if suffix == ".tet" else _read_any(path, suffix)
        points = np.asarray(points, dtype=float) * UNITS[unit]
        check_mesh(path, points, cells)
        check_size(path, points[cells])
        if cells.shape[1] == 3:
            return closed_surface(points, cells, path), None, None
        tetrahedra = _oriented(points, cells, path)
        return closed_surface(points, boundary_triangles(tetrahedra)[0], path), points, tetrahedra


def check_mesh(path: Path, points: np.ndarray, cells: np.ndarray) -> None:
    """Raises InputError unless there are ``cells`` (c, 3 or 4), all of finite ``points`` (p, 3)."""
    if not len(cells):
        raise InputError(f"{path}: no triangle and no tetrahedron in it")
    if points.ndim != 2 or points.shape[1] != 3 or cells.ndim != 2 or cells.shape[1] not in (3, 4):
        raise InputError(f"{path}: vertices {points.shape}, cells {cells.shape}; allowed: (v, 3), (c, 3) or (c, 4)")
    if not np.isfinite(points).all():
        raise InputError(f"{path}: coordinates that are not finite numbers")
    if cells.min() < 0 or cells.max() >= len(points):
        raise InputError(f"{path}: vertices {cells.min()} to {cells.max()} are named; allowed: 0 to {len(points) - 1}")


def check_body(path: Path, surface: trimesh.Trimesh) -> None:
    """Raises InputError unless a generated surface is a closed body of a fingertip's size."""
    check_mesh(path, surface.vertices, surface.faces)
    check_size(path, surface.vertices)
    extents = np.ptp(surface.vertices, axis=0)
    if not surface.is_watertight or not surface.volume > 0.0 or extents.min() < FLATTEST * extents.max():
        raise InputError(f"{path}: its sizes make no closed body")


def check_size(path: Path, points: np.ndarray) -> None:
    """Raises InputError unless points (..., 3), m, are of a fingertip's size. The usual cause is mm taken for m."""
    largest = float(np.ptp(points.reshape(-1, 3), axis=0).max())
    if not SMALLEST < largest < LARGEST:
        allowed = f"allowed: {SMALLEST:g}..{LARGEST:g} m; is its unit m or mm?"
        raise InputError(f"{path}: the shape is {largest:g} m large; {allowed}")


def _read_tet(path: Path) -> tuple[np.ndarray, np.ndarray]:
    rows = [line.split() for line in path.read_text().splitlines()]
    vertices = np.array([row[1:4] for row in rows if row and row[0] == "v"], dtype=float)
    tetrahedra = np.array([row[1:5] for row in rows if row and row[0] == "t"], dtype=np.int64)
    return vertices, tetrahedra


def _read_any(path: Path, suffix: str) -> tuple[np.ndarray, np.ndarray]:
    if suffix in SURFACE_SUFFIXES:
        mesh = trimesh.load(path, force="mesh", process=False)
        return mesh.vertices, mesh.faces
    mesh = meshio.read(path, file_format=MESHIO_FORMATS[suffix])
    for kind, second_order, corners in (("tetra", "tetra10", 4), ("triangle", "triangle6", 3)):
        if kind in mesh.cells_dict:
            return mesh.points[:, :3], mesh.cells_dict[kind]
        if second_order in mesh.cells_dict:
            used, cells = np.unique(mesh.cells_dict[second_order][:, :corners], return_inverse=True)
            return mesh.points[used, :3], cells.reshape(-1, corners)
    raise InputError(f"{path}: neither tetrahedra nor triangles, but {', '.join(mesh.cells_dict) or 'nothing'}")


def _oriented(points: np.ndarray, tetrahedra: np.ndarray, path: Path) -> np.ndarray:
    """Tetrahedra of positive volume. A file may order all of them the other way round."""
    volume = signed_volumes(points, tetrahedra)
    if (volume < 0).all():
        return tetrahedra[:, [0, 2, 1, 3]].astype(np.int32)
    if (volume <= 0).any():
        raise InputError(f"{path}: {(volume <= 0).sum()} of {len(volume)} tetrahedra are inverted or flat, allowed 0")
    return tetrahedra.astype(np.int32)


def closed_surface(points: np.ndarray, faces: np.ndarray, path: Path) -> trimesh.Trimesh:
    """Make a watertight surface with outward normals. Raises InputError if it is open."""
    surface = trimesh.Trimesh(points, faces, process=False)
    surface.merge_vertices(merge_norm=True, merge_tex=True)
    surface.remove_unreferenced_vertices()
    if not surface.is_watertight:
        raise InputError(f"{path}: the surface is open (an edge does not join exactly two faces), it must be closed")
    if not surface.is_winding_consistent or enclosed_volume(surface.vertices, surface.faces) < 0:
        surface.fix_normals(multibody=True)
    return surface


def bodies(surface: trimesh.Trimesh) -> list[trimesh.Trimesh]:
    """Closed bodies of a surface, largest first."""
    return sorted(surface.split(only_watertight=False), key=lambda body: -abs(body.volume))


def array_hash(source: str, arrays: dict[str, np.ndarray]) -> str:
    """SHA-256 of a mesh: of its arrays and of ``source``, the hash of the geometry and settings."""
    digest = hashlib.sha256(source.encode())
    for name in sorted(arrays):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(arrays[name]).tobytes())
    return digest.hexdigest()


def save_mesh(path: Path, mesh: SimulationMesh | OutputMesh, source: str) -> None:
    """Write a mesh and its ``source`` as .npz. The file is replaced in one step."""
    arrays = {field.name: getattr(mesh, field.name) for field in fields(mesh) if field.name != "hash"}
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".npz", delete=False) as file:
        np.savez_compressed(file, source=source, **arrays)
    os.chmod(file.name, 0o644)
    os.replace(file.name, path)


def load_mesh(path: Path, kind: type, source: str):
    """Read a mesh of class ``kind`` that `save_mesh` wrote; None if there is no file.

    Raises InputError if it was made from another ``source``.
    """
    if not path.is_file():
        return None
    with parsing(path, "a mesh that simgen wrote"):
        with np.load(path) as file:
            stored = str(file["source"])
            arrays = {name: file[name] for name in file.files if name != "source"}
        if stored != source:
            raise InputError(f"{path}: made from other geometry or settings than sensor.yaml now says: run simgen mesh")
        return with_hash(kind, source, arrays)


def with_hash(kind: type, source: str, arrays: dict[str, np.ndarray]):
    """Make a SimulationMesh or OutputMesh of its arrays and their hash."""
    values = dict(arrays)
    if "n_corners" in values:
        values["n_corners"] = int(values["n_corners"])
    return kind(**values, hash=array_hash(source, {k: np.asarray(v) for k, v in arrays.items()}))


def cache_folder() -> Path:
    """The user's cache."""
    return Path(os.environ.get("SIMGEN_CACHE") or platformdirs.user_cache_dir("simgen"))


def cached(source: str, kind: type, make):
    """The mesh of this ``source`` in the user's cache, or else ``make()``, which is then cached.

    Meshing differs from run to run. The first mesh stays, so that all processes use the same one.
    """
    path = cache_folder() / "meshes" / f"{source}.npz"
    found = load_mesh(path, kind, source)
    if found is not None:
        return found
    own = path.with_suffix(f".{uuid.uuid4().hex}.npz")
    save_mesh(own, make(), source)
    with contextlib.suppress(FileExistsError):
        os.link(own, path)
    own.unlink()
    return load_mesh(path, kind, source)
