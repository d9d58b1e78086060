"""A tactile sensor: its gel's true surface and meshes, its rigid core, named regions, camera and electrodes.

`load_sensor` takes the name of a bundled sensor or a folder with a ``sensor.yaml`` (see
`simgen.sensors.sensor_schema`). Everything is in metres, in the sensor's own frame.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from simgen.errors import InputError
from simgen.geometry.surface import ClosestPoint
from simgen.geometry.tetrahedra import OutputMesh, SimulationMesh
from simgen.sensors import sensor_meshes
from simgen.sensors.sensor_geometry import load_geometry
from simgen.sensors.sensor_meshes import OutputMeshFile
from simgen.sensors.sensor_schema import CameraSettings, Electrodes, Material
from simgen.sensors.support import Support, load_support
from simgen.units import MM


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
