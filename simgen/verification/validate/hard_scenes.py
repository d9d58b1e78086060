"""Scenes and paths of the hard cases: a small bonded block, and places on the bundled sensors."""

import numpy as np

from simgen.sensors.sensor import Material, Sensor, load_sensor
from simgen.simulation.press import Scene, SolverSettings
from simgen.units import MM
from simgen.verification.validate.layer_meshes import make_sensor
from simgen.verification.validate.meshes import Mesh, box, on_plane

GEL = Material(youngs_modulus_pa=539e3, poisson_ratio=0.499, friction=0.78, source="the DIGIT's gel")
COUNTS, SIZE_MM = (4, 2, 4), (10.0, 4.0, 10.0)  # cells and size of the block

# x along the finger and arc across it, mm
DIGIT_MM = {"centre": (-7.5, 0.0), "rim": (-7.5, 8.75), "arch": (-18.5, 0.0), "corner": (3.0, 7.7)}
BIOTAC_MM = {"pad": (-7.5, 0.0), "tip": (-19.0, 0.0), "side": (-7.5, 9.5)}


def block(mesh: Mesh | None = None) -> Sensor:
    """Make a block with a fixed bottom and touchable other faces; its output vertices are its corner nodes."""
    mesh = mesh or box(COUNTS, SIZE_MM)
    fixed = on_plane(mesh.nodes, 1, mesh.nodes[:, 1].max())
    free = mesh.faces[~fixed[mesh.faces].all(axis=1)]
    return make_sensor(mesh, fixed, free, mesh.nodes[: mesh.n_corners])


def scene_of(sensor: Sensor, device: str, settings: SolverSettings | None = None, **changes) -> Scene:
    """Make a scene of a sensor of the DIGIT's gel; ``changes`` replace values of the material."""
    return Scene(sensor, Material(**{**GEL.model_dump(), **changes}), device=device, settings=settings)


def above_block(x_mm: float = 0.0, y_mm: float = -0.5) -> np.ndarray:
    """Return the pose (4, 4) of an indenter over the block, ``x_mm`` beside its middle."""
    pose = np.eye(4)
    pose[:2, 3] = x_mm * MM, y_mm * MM
    return pose


def bundled(name: str, device: str, **changes) -> Scene:
    """Make a scene of a bundled sensor on its coarse mesh."""
    return scene_of(load_sensor(name, "coarse"), device, **changes)


def down(depth_mm: float, steps: int) -> np.ndarray:
    """Make a path (steps, 3) m in equal steps along the indenter's axis."""
    return np.linspace(depth_mm / steps, depth_mm, steps)[:, None] * [0.0, MM, 0.0]


def sideways(depth_mm: float, shear_mm: float, steps: int) -> np.ndarray:
    """Make a path (steps, 3) m in equal steps along the indenter's x, at one depth."""
    path = np.zeros((steps, 3))
    path[:, 0] = np.linspace(shear_mm / steps, shear_mm, steps) * MM
    path[:, 1] = depth_mm * MM
    return path
