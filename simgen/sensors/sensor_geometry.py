"""The shape of a sensor before meshing: the gel's true surface with its regions, and the rigid core."""

import hashlib
import json
import os
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
import trimesh

from simgen.config.parsing import parsing
from simgen.config.resources import resource
from simgen.errors import InputError
from simgen.geometry import mesh_files
from simgen.geometry.curved_tetrahedra import CORE, FREE, HELD, LabelledSurface
from simgen.geometry.region_edges import NEAR, cut
from simgen.geometry.surface import ClosestPoint, enclosed_volume, patches_at, shells, smooth_patches
from simgen.sensors import height_fields, polar_bodies, shape_cache
from simgen.sensors.sensor_schema import Core, Gel, MeshSize, Selection, SensorDescription, read_description
from simgen.sensors.shape_cache import BuiltShape
from simgen.units import MM

FINEST_PIECES = 100_000  # most triangles of a surface that is refined to follow its regions
MESHING_VERSION = 2  # part of each mesh's source hash; raise it when the same settings give other meshes
MOST_BUILT = 4
_built: dict[tuple, BuiltShape] = {}  # shapes by folder, source and the size that their surface is refined to


@dataclass(frozen=True)
class SensorGeometry:
    """Shape of a sensor, as its ``sensor.yaml`` describes it. Lengths in m."""

    description: SensorDescription
    folder: Path
    plain: trimesh.Trimesh  # the surface as given, for the mesher
    true: LabelledSurface  # the same surface in triangles fine enough to follow its regions
    held_regions: dict[str, np.ndarray]  # name -> (faces,) bool on ``true``
    own_vertices: np.ndarray | None  # (v, 3) of a user's tetrahedral file
    own_tetrahedra: np.ndarray | None
    core: trimesh.Trimesh | None
    source: str  # hash of shape and regions, see `geometry_source`

    def mesh_source(self, settings: MeshSize | str) -> str:
        """Hash of the surface and the settings that a mesh is made from."""
        text = settings if isinstance(settings, str) else settings.model_dump_json(exclude_none=True)
        return hashlib.sha256(f"{MESHING_VERSION} {self.source} {text}".encode()).hexdigest()

    def selected(self, points: np.ndarray) -> np.ndarray:
        """Mask (n,) of points (n, 3) that lie in a held region."""
        held = np.zeros(len(points), dtype=bool)
        for selection in self.description.held.values():
            held |= select(selection, points, self.folder)
        return held


def sensor_folder(model: str | Path) -> Path:
    """Folder of a bundled sensor's name or of a user's path. Raises InputError if it has no ``sensor.yaml``.

    The text ``digit`` is the bundled sensor. A user's folder of that name is ``./digit``, or a `Path`.
    """
    folder = resource("sensor_models") / model if model in bundled_sensors() else Path(model)
    folder = folder.parent if folder.name == "sensor.yaml" else folder
    if not os.path.isfile(folder / "sensor.yaml"):
        allowed = ", ".join(bundled_sensors())
        raise InputError(f"sensor {str(model)!r}: allowed: {allowed}, or a folder with a sensor.yaml")
    return folder


def bundled_sensors() -> list[str]:
    return sorted(path.parent.name for path in resource("sensor_models").glob("*/sensor.yaml"))


def load_geometry(model: str | Path) -> SensorGeometry:
    """Load the true surface with its regions, the core and the user's tetrahedra. Raises InputError.

    A shape takes up to a second to build. So it is kept in the user's cache (see `shape_cache`), and the process keeps
    the last ones: do not change their arrays.
    """
    folder = sensor_folder(model)
    description = read_description(folder / "sensor.yaml")
    try:
        source = geometry_source(description, folder)
    except OSError:
        _build(description, folder)  # raises an InputError that names the file
        raise
    size = description.meshes.default
    key = folder, source, str(size)
    if key not in _built:
        shape = hashlib.sha256(f"{source} {size}".encode()).hexdigest()
        _built[key] = shape_cache.cached(
            shape, lambda: _build(description, folder), lambda: geometry_source(description, folder) == source
        )
        if len(_built) > MOST_BUILT:
            _built.pop(next(iter(_built)), None)
    return SensorGeometry(description, folder, *_built[key], source)


def _build(description: SensorDescription, folder: Path) -> BuiltShape:
    path = folder / "sensor.yaml"
    plain, vertices, tetrahedra = gel_surface(description.gel, folder)
    size = description.meshes.default
    reach = np.inf if isinstance(size, str) else NEAR * size.edge_length_mm * MM
    surface = cut_at_edges(refined(plain, size), description.held, folder, reach)
    core = core_surface(description.core, description.gel, folder) if description.core else None
    region = np.full(len(surface.faces), FREE, dtype=np.int8)
    if core is not None:
        cavity = cavity_faces(surface)
        if not cavity.any():
            raise InputError(f"{path}: core: the gel has no cavity for it: its surface must have an inner closed shell")
        region[cavity] = CORE
    held_regions = {}
    for name, selection in description.held.items():
        inside = select(selection, surface.triangles_center, folder)
        if not inside.any():
            raise InputError(f"{path}: held.{name}: selects no triangle of the surface, at least one is needed")
        held_regions[name] = inside
        region[inside] = HELD
    return BuiltShape(plain, LabelledSurface(surface, region), held_regions, vertices, tetrahedra, core)


def geometry_source(description: SensorDescription, folder: Path) -> str:
    """Hash of the keys that decide shape and regions, and of the files that they name."""
    shape = description.model_dump(include={"gel", "held", "core"}, exclude={"core": {"friction"}}, exclude_none=True)
    digest = hashlib.sha256(json.dumps(shape, sort_keys=True).encode())
    for file in sorted(_files(shape)):
        digest.update((folder / file).read_bytes())
    return digest.hexdigest()


def _files(value) -> set[str]:
    if not isinstance(value, dict):
        return set()
    own = {value["file"]} if isinstance(value.get("file"), str) else set()
    return own.union(*(_files(inner) for inner in value.values()))


def gel_surface(gel: Gel, folder: Path) -> tuple[trimesh.Trimesh, np.ndarray | None, np.ndarray | None]:
    """Closed surface of the gel, and vertices and tetrahedra if a file gives them (else None)."""
    if gel.mesh is not None:
        return mesh_files.read_mesh(folder / gel.mesh.file, gel.mesh.unit)
    path = folder / "sensor.yaml"
    with parsing(path, "a gel"):  # sizes can be valid alone and yet make no body together
        if gel.polar_shell is not None:
            surface = polar_bodies.shell_surface(gel.polar_shell)
        elif gel.dome is not None:
            surface = height_fields.dome_surface(gel.dome)
        else:
            surface = height_fields.pad_surface(gel.pad)
        mesh_files.check_body(path, surface)
    return surface, None, None


def core_surface(core: Core, gel: Gel, folder: Path) -> trimesh.Trimesh:
    """Closed surface of the rigid core."""
    if (own := core.polar_core) is not None:
        path = folder / "sensor.yaml"
        with parsing(path, "a core"):
            body = polar_bodies.core_body(own.table, own.axis_y_mm, own.spacing_mm, gel.polar_shell, own.clearance_mm)
            mesh_files.check_body(path, body)
        return body
    surface, _, _ = mesh_files.read_mesh(folder / core.mesh.file, core.mesh.unit)
    return mesh_files.bodies(surface)[0]


def refined(surface: trimesh.Trimesh, size: MeshSize | str) -> trimesh.Trimesh:
    """Refine a surface to triangles no longer than the mesh's edges, and to `FINEST_PIECES` triangles at most."""
    wanted = np.inf if isinstance(size, str) else size.edge_length_mm * MM
    vertices, faces = surface.vertices, surface.faces
    while np.ptp(vertices[faces], axis=1).max() > wanted and 4 * len(faces) <= FINEST_PIECES:
        vertices, faces = trimesh.remesh.subdivide(vertices, faces)
    return trimesh.Trimesh(vertices, faces, process=False)


def cut_at_edges(surface: trimesh.Trimesh, held: dict[str, Selection], folder: Path, reach: float) -> trimesh.Trimesh:
    """Cut a surface along the edges of all held regions; see `region_edges.cut`."""
    for selection in held.values():
        inside = partial(select, selection, folder=folder)
        meeting = patches_at(len(surface.vertices), surface.faces, smooth_patches(surface))
        vertices, faces = cut(surface.vertices, surface.faces, surface.edges_unique, inside, meeting, reach)
        surface = trimesh.Trimesh(vertices, faces, process=False)
    return surface


def cavity_faces(surface: trimesh.Trimesh) -> np.ndarray:
    """Mask (f,) of faces of closed shells that enclose a void: their signed volume is negative."""
    inside = np.zeros(len(surface.faces), dtype=bool)
    for faces in shells(surface):
        inside[faces] = enclosed_volume(surface.vertices, surface.faces[faces]) < 0
    return inside


def select(selection: Selection, points: np.ndarray, folder: Path) -> np.ndarray:
    """Mask (n,) of points (n, 3) m that a selection of a ``sensor.yaml`` covers."""
    mm = points / MM
    if plane := selection.plane:
        return np.abs(mm[:, "xyz".index(plane.axis)] - plane.at_mm) <= plane.within_mm
    if box := selection.box:
        bounds = [(i, b) for i, b in enumerate((box.x_mm, box.y_mm, box.z_mm)) if b is not None]
        return np.all([(mm[:, i] >= low) & (mm[:, i] <= high) for i, (low, high) in bounds], axis=0)
    if cylinder := selection.cylinder:
        axis = "xyz".index(cylinder.axis)
        across = np.delete(mm, axis, axis=1) - cylinder.center_mm
        low, high = cylinder.along_mm
        return (np.hypot(*across.T) <= cylinder.radius_mm) & (mm[:, axis] >= low) & (mm[:, axis] <= high)
    touching = selection.touching
    return _body(folder / touching.file, touching.unit)(points)[1] <= touching.within_mm * MM


def _body(path: Path, unit: str) -> ClosestPoint:
    """Closest points on a mesh file."""
    found = path.stat() if os.path.isfile(path) else None
    state = found and (found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns)
    return _read_body(path, unit, state)


@lru_cache(maxsize=4)
def _read_body(path: Path, unit: str, state: tuple[int, ...] | None) -> ClosestPoint:
    """Closest points on a mesh file; ``state``, its inode, size and time stamps, is part of the cache's key."""
    body, _, _ = mesh_files.read_mesh(path, unit)
    return ClosestPoint(body.vertices, body.faces)
