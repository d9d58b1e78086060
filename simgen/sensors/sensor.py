"""A tactile sensor as it is simulated: surface, meshes, rigid core, regions, camera and electrodes.

`load_sensor` reads a bundled sensor or a folder with a ``sensor.yaml`` (see `simgen.sensors.sensor_schema`). Lengths
are in metres, in the sensor's own frame.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import trimesh

from simgen.errors import InputError
from simgen.geometry.curved_tetrahedra import CORE
from simgen.geometry.surface import ClosestPoint, FinePieces
from simgen.geometry.tetrahedra import OutputMesh, SimulationMesh
from simgen.sensors import sensor_meshes
from simgen.sensors.material import Material
from simgen.sensors.sensor_geometry import load_geometry
from simgen.sensors.sensor_meshes import OutputMeshFile
from simgen.sensors.sensor_schema import CameraSettings, Electrodes
from simgen.sensors.support import Support, load_support
from simgen.units import MM


@dataclass(frozen=True)
class Camera:
    """A pinhole camera and its lights, in the sensor's frame."""

    position: np.ndarray  # (3,) m
    looks_along: np.ndarray  # (3,) unit vector
    up: np.ndarray  # (3,) unit vector, upwards in the image
    vertical_field_of_view_deg: float
    width_px: int
    height_px: int
    lights: dict[str, np.ndarray]  # colour -> (3,) m


@dataclass(frozen=True, eq=False)
class Sensor:
    """One sensor with its meshes. Lengths in m."""

    name: str
    surface: trimesh.Trimesh  # closed true surface of the gel in fine triangles, with the cavity's surface
    surface_region: np.ndarray  # (faces,) 0 touchable, 1 held, 2 facing the core
    simulation_mesh: SimulationMesh
    output_mesh: OutputMesh
    materials: dict[str, Material]  # presets by name
    core: trimesh.Trimesh | None  # rigid body inside; the mesh's ``facing_core`` faces can meet it
    core_friction: float
    electrodes: np.ndarray | None  # (k, 3) m, on the core
    cameras: dict[str, Camera]  # by name; empty for a sensor without cameras
    held_regions: dict[str, np.ndarray]  # name -> (faces,) bool on ``surface``
    output_moves_with: np.ndarray | None = None  # (v, 3) m, points of the gel; None: the vertices
    support: Support | None = None  # rigid body under the gel; free faces can meet it

    @property
    def output_points(self) -> np.ndarray:
        """Points of the gel, (v, 3) m, with which the vertices of the output mesh move."""
        return self.output_mesh.vertices if self.output_moves_with is None else self.output_moves_with

    @cached_property
    def inner_side(self) -> ClosestPoint | None:
        """Closest points on the gel's inner side, which faces the core; None without a core."""
        if self.core is None:
            return None
        return ClosestPoint(self.surface.vertices, self.surface.faces[self.surface_region == CORE])

    @cached_property
    def pieces(self) -> FinePieces:
        """The surface's triangles, to be subdivided on demand."""
        return FinePieces(self.surface.triangles)

    @cached_property
    def bounds(self) -> tuple[FinePieces, np.ndarray]:
        """Bounds of the room for a press, and their normals (f, 3) out of the room.

        They are the gel's surface without its inner side, and the core from outside.
        """
        normals = self.surface.face_normals
        if self.core is None:
            return self.pieces, normals
        outer = self.surface_region != CORE
        triangles = np.concatenate([self.surface.triangles[outer], self.core.triangles])
        return FinePieces(triangles), np.concatenate([normals[outer], -self.core.face_normals])


def load_sensor(model: str | Path, mesh: str = "default", output: OutputMeshFile | None = None) -> Sensor:
    """Load a sensor with its simulation mesh ``default``, ``coarse`` or ``fine``, and its output mesh.

    Meshes come from the sensor's folder or from the user's cache. Missing meshes are made, checked by the quality gates
    and cached. ``output``, a file of tetrahedra, replaces the sensor's own output mesh. Raises InputError for a bad
    ``sensor.yaml``, mesh file or mesh.
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
        cameras={name: place_camera(each) for name, each in description.cameras.items()},
        held_regions=shape.held_regions,
        output_moves_with=moves_with,
        support=load_support(description.support, shape.folder, shape.true) if description.support else None,
    )


def remake(model: str | Path) -> list[str]:
    """Make and check all meshes of a sensor, write them into its folder, and return a line about each.

    Raises InputError if a mesh fails its quality gates; the old files then stay.
    """
    return sensor_meshes.remake(load_geometry(model))


def place_electrodes(electrodes: Electrodes, core: trimesh.Trimesh) -> np.ndarray:
    """Electrodes (k, 3) m in the sensor's frame, moved to the nearest points of the core."""
    x, z = (np.array(axis) / np.linalg.norm(axis) for axis in (electrodes.x_axis, electrodes.z_axis))
    own = np.column_stack([electrodes.x_mm, electrodes.y_mm, electrodes.z_mm])
    points = (np.array(electrodes.origin_mm) + own @ np.array([x, np.cross(z, x), z])) * MM
    return ClosestPoint(core.vertices, core.faces)(points)[0]


def place_camera(settings: CameraSettings) -> Camera:
    """Place camera and lights in the sensor's frame. Angles of lights count from the image's right to its top."""
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
