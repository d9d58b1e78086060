"""A tactile sensor: its gel's true surface and meshes, its rigid core, named regions, camera and electrodes.

`load_sensor` takes the name of a bundled sensor or a folder with a ``sensor.yaml`` (see
`simgen.sensor_schema`). Everything is in metres, in the sensor's own frame.
"""

import hashlib
import json
import os
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
import trimesh

from simgen import geometry, mesh_files, sensor_meshes
from simgen.curved import CORE, FREE, HELD, LabelledSurface
from simgen.errors import InputError
from simgen.parsing import parsing
from simgen.region_edges import NEAR, cut
from simgen.resources import resource
from simgen.sensor_meshes import OutputMeshFile
from simgen.sensor_schema import (
    CameraSettings,
    Core,
    Electrodes,
    Gel,
    Material,
    MeshSize,
    Selection,
    SensorDescription,
    read_description,
)
from simgen.support import Support, load_support
from simgen.surface import ClosestPoint, enclosed_volume, patches_at, shells, smooth_patches
from simgen.tetrahedra import OutputMesh, SimulationMesh

MM = 1e-3
FINEST_PIECES = 100_000  # triangles, at most, into which a user's surface is cut to follow its regions
MESHING_VERSION = 2  # part of every mesh's source: raise it when the same settings make other meshes


@dataclass(frozen=True)
class Camera:
    """A pinhole camera and its lights, in the sensor's frame."""

    position: np.ndarray  # (3,) m
    looks_along: np.ndarray  # (3,) unit vector
    up: np.ndarray  # (3,) unit vector: the image's upward direction
    vertical_field_of_view_deg: float
    width_px: int
    height_px: int
    lights: dict[str, np.ndarray]  # colour -> (3,) m


@dataclass(frozen=True)
class Sensor:
    """One sensor, ready to be meshed, pressed and drawn. Lengths in m."""

    name: str
    surface: trimesh.Trimesh  # fine closed true surface of the gel (with its cavity, if it has one)
    surface_region: np.ndarray  # (faces,) 0 touchable, 1 held, 2 facing the core
    simulation_mesh: SimulationMesh
    output_mesh: OutputMesh
    materials: dict[str, Material]  # presets by name
    core: trimesh.Trimesh | None  # rigid body inside; the mesh's ``facing_core`` faces may meet it
    core_friction: float
    electrodes: np.ndarray | None  # (k, 3) m, on the core
    camera: Camera | None
    held_regions: dict[str, np.ndarray]  # name -> (faces,) bool on ``surface``
    output_moves_with: np.ndarray | None = None  # (v, 3) points of the gel for vertices off it; None: the vertices
    support: Support | None = None  # rigid body under the gel; free faces may come to lie on it

    @property
    def output_points(self) -> np.ndarray:
        """(v, 3) m, the points of the gel whose values the vertices of the output mesh have."""
        return self.output_mesh.vertices if self.output_moves_with is None else self.output_moves_with


@dataclass(frozen=True)
class SensorGeometry:
    """What a ``sensor.yaml`` says about shape, before any mesh is made."""

    description: SensorDescription
    folder: Path
    plain: trimesh.Trimesh  # the surface as it came, for the mesher
    true: LabelledSurface  # the same in triangles fine enough to follow its regions
    held_regions: dict[str, np.ndarray]
    own_vertices: np.ndarray | None  # of a user's tetrahedral file
    own_tetrahedra: np.ndarray | None
    core: trimesh.Trimesh | None
    source: str  # hash of everything above

    def mesh_source(self, settings: MeshSize | str) -> str:
        """Hash of surface and settings: what a mesh is made from."""
        text = settings if isinstance(settings, str) else settings.model_dump_json(exclude_none=True)
        return hashlib.sha256(f"{MESHING_VERSION} {self.source} {text}".encode()).hexdigest()

    def selected(self, points: np.ndarray) -> np.ndarray:
        """Which points (n, 3) lie in any held region."""
        held = np.zeros(len(points), dtype=bool)
        for selection in self.description.held.values():
            held |= select(selection, points, self.folder)
        return held


def sensor_folder(model: str | Path) -> Path:
    """The folder of a bundled sensor's name or of a user's path; raises InputError where there is none.

    A text that is a bundled name means that one: a folder of the same name is ``./digit``, or a `Path`.
    """
    folder = resource("sensor_models") / model if model in bundled_sensors() else Path(model)
    folder = folder.parent if folder.name == "sensor.yaml" else folder
    if not os.path.isfile(folder / "sensor.yaml"):
        allowed = ", ".join(bundled_sensors())
        raise InputError(f"sensor {str(model)!r}: allowed: {allowed}, or a folder with a sensor.yaml")
    return folder


def bundled_sensors() -> list[str]:
    return sorted(path.parent.name for path in resource("sensor_models").glob("*/sensor.yaml"))


def load_sensor(model: str | Path, mesh: str = "default", output: OutputMeshFile | None = None) -> Sensor:
    """The sensor with its simulation mesh ``default``, ``coarse`` or ``fine``, and its output mesh.

    Meshes come from the sensor's own folder (the bundled ones), else from the user's cache, else they are
    made, gated and cached. A file of tetrahedra, ``output``, replaces the sensor's own output mesh. Raises
    InputError on a bad ``sensor.yaml``, mesh file or mesh.
    """
    shape = load_geometry(model)
    description = shape.description
    if mesh not in sensor_meshes.NAMES:
        raise InputError(f"sensor {description.name}: mesh = {mesh!r}, allowed: {', '.join(sensor_meshes.NAMES)}")
    core_friction = description.core.friction if description.core else 0.0
    solved = sensor_meshes.simulation_mesh(shape, mesh)
    if output is None:
        stored, moves_with = sensor_meshes.output_mesh(shape), None
    else:
        stored, moves_with = sensor_meshes.output_from_file(shape, output, solved)
    return Sensor(
        name=description.name,
        surface=shape.true.surface,
        surface_region=shape.true.region,
        simulation_mesh=solved,
        output_mesh=stored,
        materials=description.materials,
        core=shape.core,
        core_friction=core_friction,
        electrodes=place_electrodes(description.electrodes, shape.core) if description.electrodes else None,
        camera=place_camera(description.camera) if description.camera else None,
        held_regions=shape.held_regions,
        output_moves_with=moves_with,
        support=load_support(description.support, shape.folder, shape.true) if description.support else None,
    )


def remake(model: str | Path) -> list[str]:
    """Make all meshes of a sensor again, gate them and write them into its folder: a line on each.

    Raises InputError where a mesh fails its gates; what was there before then stays.
    """
    return sensor_meshes.remake(load_geometry(model))


def load_geometry(model: str | Path) -> SensorGeometry:
    """The true surface with its regions, the core and the user's own tetrahedra."""
    folder = sensor_folder(model)
    path = folder / "sensor.yaml"
    description = read_description(path)
    plain, vertices, tetrahedra = gel_surface(description.gel, folder)
    size = description.meshes.default
    reach = np.inf if isinstance(size, str) else NEAR * size.edge_length_mm * MM
    surface = cut_at_edges(refined(plain, size), description.held, folder, reach)
    core = core_surface(description.core, description.gel, folder) if description.core else None
    region = np.full(len(surface.faces), FREE, dtype=np.int8)
    if core is not None:
        cavity = cavity_faces(surface)
        if not cavity.any():
            raise InputError(
                f"{path}: core: the gel has no cavity for it: its surface must have an inner closed shell"
            )
        region[cavity] = CORE
    held_regions = {}
    for name, selection in description.held.items():
        inside = select(selection, surface.triangles_center, folder)
        if not inside.any():
            raise InputError(
                f"{path}: held.{name}: selects no triangle of the surface, at least one is needed"
            )
        held_regions[name] = inside
        region[inside] = HELD
    return SensorGeometry(
        description, folder, plain, LabelledSurface(surface, region), held_regions, vertices, tetrahedra,
        core, geometry_source(description, folder),
    )  # fmt: skip


def geometry_source(description: SensorDescription, folder: Path) -> str:
    """Hash of the keys that decide shape and regions, and of the files that they name."""
    shape = description.model_dump(
        include={"gel", "held", "core"}, exclude={"core": {"friction"}}, exclude_none=True
    )
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
    """Closed surface of the gel, and the vertices and tetrahedra of a tetrahedral file."""
    if gel.mesh is not None:
        return mesh_files.read_mesh(folder / gel.mesh.file, gel.mesh.unit)
    path = folder / "sensor.yaml"
    with parsing(path, "a gel"):  # whatever sizes lead to that make no body
        shell, dome = gel.polar_shell, gel.dome
        surface = geometry.shell_surface(shell) if shell is not None else geometry.dome_surface(dome)
        mesh_files.check_body(path, surface)
    return surface, None, None


def core_surface(core: Core, gel: Gel, folder: Path) -> trimesh.Trimesh:
    """Closed surface of the rigid core."""
    if (own := core.polar_core) is not None:
        path = folder / "sensor.yaml"
        with parsing(path, "a core"):
            body = geometry.core_body(own.table, own.axis_y_mm, own.spacing_mm, gel.polar_shell, own.clearance_mm)
            mesh_files.check_body(path, body)
        return body
    surface, _, _ = mesh_files.read_mesh(folder / core.mesh.file, core.mesh.unit)
    return mesh_files.bodies(surface)[0]


def refined(surface: trimesh.Trimesh, size: MeshSize | str) -> trimesh.Trimesh:
    """The same surface in triangles no longer than the mesh's edges, or in `FINEST_PIECES` of them at most."""
    wanted = np.inf if isinstance(size, str) else size.edge_length_mm * MM
    vertices, faces = surface.vertices, surface.faces
    while np.ptp(vertices[faces], axis=1).max() > wanted and 4 * len(faces) <= FINEST_PIECES:
        vertices, faces = trimesh.remesh.subdivide(vertices, faces)
    return trimesh.Trimesh(vertices, faces, process=False)


def cut_at_edges(
    surface: trimesh.Trimesh, held: dict[str, Selection], folder: Path, reach: float
) -> trimesh.Trimesh:
    """The same surface with triangle edges along the edges of all held regions; see `region_edges.cut`."""
    for selection in held.values():
        inside = partial(select, selection, folder=folder)
        meeting = patches_at(len(surface.vertices), surface.faces, smooth_patches(surface))
        vertices, faces = cut(surface.vertices, surface.faces, surface.edges_unique, inside, meeting, reach)
        surface = trimesh.Trimesh(vertices, faces, process=False)
    return surface


def cavity_faces(surface: trimesh.Trimesh) -> np.ndarray:
    """Which faces belong to closed shells that enclose a void: their signed volume is negative."""
    inside = np.zeros(len(surface.faces), dtype=bool)
    for faces in shells(surface):
        inside[faces] = enclosed_volume(surface.vertices, surface.faces[faces]) < 0
    return inside


def select(selection: Selection, points: np.ndarray, folder: Path) -> np.ndarray:
    """Which points (n, 3) in m a selection of a ``sensor.yaml`` holds: (n,) bool."""
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
    path = folder / touching.file
    changed = path.stat().st_mtime_ns if os.path.isfile(path) else 0
    return _body(path, touching.unit, changed)(points)[1] <= touching.within_mm * MM


@lru_cache(maxsize=4)
def _body(path: Path, unit: str, changed: int) -> ClosestPoint:
    """Closest points on a mesh file as it was when it had ``changed`` last."""
    body, _, _ = mesh_files.read_mesh(path, unit)
    return ClosestPoint(body.vertices, body.faces)


def place_electrodes(electrodes: Electrodes, core: trimesh.Trimesh) -> np.ndarray:
    """Electrodes (k, 3) in m in the sensor's frame, moved to the nearest points of the core."""
    x, z = (np.array(axis) / np.linalg.norm(axis) for axis in (electrodes.x_axis, electrodes.z_axis))
    own = np.column_stack([electrodes.x_mm, electrodes.y_mm, electrodes.z_mm])
    points = (np.array(electrodes.origin_mm) + own @ np.array([x, np.cross(z, x), z])) * MM
    return ClosestPoint(core.vertices, core.faces)(points)[0]


def place_camera(settings: CameraSettings) -> Camera:
    """Camera and lights in the sensor's frame; light angles count from the image's right to its top."""
    forward, up = (np.array(v) / np.linalg.norm(v) for v in (settings.looks_along, settings.up))
    right = np.cross(forward, up)
    position = np.array(settings.position_mm) * MM
    radius = settings.light_circle_radius_mm * MM
    angles = {colour: np.radians(angle) for colour, angle in settings.light_angles_deg.items()}
    return Camera(
        position=position,
        looks_along=forward,
        up=up,
        vertical_field_of_view_deg=settings.vertical_field_of_view_deg,
        width_px=settings.width_px,
        height_px=settings.height_px,
        lights={c: position + radius * (np.cos(a) * right + np.sin(a) * up) for c, a in angles.items()},
    )
