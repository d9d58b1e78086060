"""A small block of gel, and indenters for it."""

import numpy as np
import trimesh
from fem.box import box

from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from simgen.geometry.tetrahedra import OutputMesh, SimulationMesh
from simgen.sensors.sensor import Material, Sensor
from simgen.units import MM

SPHERE, CUBE = rigid_shape(Kind.SPHERE, 3.5), rigid_shape(Kind.CUBE, 7.0, 1.0)
RIGID_EDGE = rigid_shape(Kind.CUBE, 2.5, 0.3)
GEL = Material(youngs_modulus_pa=539e3, poisson_ratio=0.499, friction=0.78)
DEPTHS = np.array([0.2e-3, 0.4e-3])


def make_block(counts) -> Sensor:
    """10 x 4 x 10 mm, bonded at the bottom, in so many cells."""
    nodes, tets, n_corners, faces = box(counts, (10.0, 4.0, 10.0))
    fixed = nodes[:, 1] > 4.0 - 1e-9
    free = faces[~fixed[faces].all(axis=1)]
    simulation = SimulationMesh(nodes * MM, n_corners, tets, fixed, free, np.zeros((0, 6), np.int32), "box")
    corners = nodes[:n_corners] * MM
    surface = trimesh.Trimesh(corners, faces[:, :3], process=False)
    output = OutputMesh(corners, tets[:, :4], faces[:, :3], fixed[:n_corners], ~fixed[:n_corners], "box")
    return Sensor("block", surface, np.zeros(len(faces), np.int8), simulation, output, {"solid": GEL}, None, 0.0, None,
                  None, {})  # fmt: skip


def pose(x=0.0, y=-0.5, z=0.0, tilt_deg=0.0):
    c, s = np.cos(np.radians(tilt_deg)), np.sin(np.radians(tilt_deg))
    out = np.eye(4)[None].copy()
    out[0, :3, :3] = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
    out[0, :3, 3] = np.array([x, y, z]) * MM
    return out
