"""Bodies around a line along x, given by their radius over (x, angle) in mm: the BioTac's skin and core.

Surfaces are in metres.
"""

import numpy as np
import trimesh
from scipy.interpolate import PchipInterpolator
from scipy.spatial import cKDTree

from simgen.geometry.surface import ClosestPoint
from simgen.sensors.sensor_schema import PolarShell, PolarTable
from simgen.units import MM


class PolarBody:
    """Radius, mm, about the line y = axis_y, z = 0, as a function of x and of the angle from -y, even in the angle.

    Along x, r^2 is interpolated: it is linear in x near a round tip, so the cap is round.
    """

    def __init__(self, table: PolarTable, axis_y: float):
        rows = np.array(table.rows_mm)
        self.axis_y = axis_y
        self.x = np.concatenate([[table.tip_mm], rows[:, 0]])
        angles = np.radians(table.angles_deg)
        # Mirror at both ends: the radius is even about the pad (0) and about the nail (pi).
        mirrored = np.concatenate([-angles[:0:-1], angles, 2.0 * np.pi - angles[-2::-1]])
        radius = np.concatenate([rows[:, :0:-1][:, :-1], rows[:, 1:], rows[:, -2:0:-1]], axis=1)
        self.over_angle = PchipInterpolator(mirrored, radius, axis=1)

    def squared(self, angles: np.ndarray) -> PchipInterpolator:
        """Interpolate r^2, mm2, over x, for each of the angles (a,) in 0..pi."""
        radius = self.over_angle(angles)
        return PchipInterpolator(self.x, np.concatenate([np.zeros((1, len(angles))), radius**2]), axis=0)

    def stations(self, spacing: float) -> np.ndarray:
        """Return x of the rings, mm, evenly spaced along the profile; the tip is left out, the rear edge included."""
        s = np.linspace(0.0, 1.0, 4001)
        x = self.x[0] + (self.x[-1] - self.x[0]) * s**2
        r = np.sqrt(self.squared(np.array([np.pi / 2]))(x)[:, 0])
        arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(r)))])
        count = int(np.ceil(arc[-1] / spacing))
        return np.interp(np.linspace(0.0, arc[-1], count + 1)[1:], arc, x)

    def surface(self, spacing: float) -> tuple[np.ndarray, np.ndarray]:
        """Triangulate with edges of about ``spacing`` mm: vertices (v, 3) mm, faces (f, 3); closed, outward."""
        stations = self.stations(spacing)
        widest = np.sqrt(self.squared(np.linspace(0, np.pi, 19))(self.x).max())
        around = 2 * int(np.ceil(np.pi * widest / spacing))
        angle = 2.0 * np.pi * np.arange(around) / around
        radius = np.sqrt(self.squared(np.minimum(angle, 2.0 * np.pi - angle))(stations))
        # The flat rear end: its edge shrinks towards the middle.
        rear_rings = int(np.ceil(radius[-1].min() / spacing))
        shrink = 1.0 - np.arange(1, rear_rings) / rear_rings
        x = np.concatenate([stations, np.full(len(shrink), stations[-1])])
        radius = np.concatenate([radius, shrink[:, None] * radius[-1]])
        ring = np.stack([
            np.broadcast_to(x[:, None], radius.shape),
            self.axis_y - radius * np.cos(angle),
            radius * np.sin(angle),
        ], axis=-1)  # fmt: skip
        poles = np.array([[self.x[0], self.axis_y, 0.0], [x[-1], self.axis_y, 0.0]])
        return np.concatenate([poles[:1], ring.reshape(-1, 3), poles[1:]]), closed_rings(len(x), around)


def closed_rings(rings: int, around: int) -> np.ndarray:
    """Faces (f, 3) of a stack of rings between two poles. Vertex 0 and the last vertex are the poles."""
    i = np.arange(around)
    j = (i + 1) % around
    first = np.column_stack([np.zeros(around, int), 1 + i, 1 + j])
    last_ring = 1 + (rings - 1) * around
    last = np.column_stack([np.full(around, last_ring + around), last_ring + j, last_ring + i])
    between = []
    for ring in range(rings - 1):
        a, b = 1 + ring * around, 1 + (ring + 1) * around
        between += [np.column_stack([a + i, b + i, b + j]), np.column_stack([a + i, b + j, a + j])]
    return np.concatenate([first, *between, last])


def outward(vertices: np.ndarray, faces: np.ndarray) -> trimesh.Trimesh:
    """Make a surface in metres from vertices in mm, oriented to enclose a positive volume."""
    surface = trimesh.Trimesh(vertices * MM, faces, process=False)
    if surface.volume < 0:
        surface.invert()
    return surface


def shell_surface(shell: PolarShell) -> trimesh.Trimesh:
    """Outer and inner surface of a skin, m; the inner one faces into the cavity."""
    outer = outward(*PolarBody(shell.outer, shell.axis_y_mm).surface(shell.spacing_mm))
    inner = outward(*PolarBody(shell.inner, shell.axis_y_mm).surface(shell.spacing_mm))
    inner.invert()
    return trimesh.util.concatenate([outer, inner])


def core_body(
    table: PolarTable, axis_y: float, spacing: float, shell: PolarShell, clearance: float
) -> trimesh.Trimesh:
    """Make the rigid core, m, at least ``clearance`` (mm) inside the skin's inner surface."""
    core = outward(*PolarBody(table, axis_y).surface(spacing))
    skin = outward(*PolarBody(shell.inner, shell.axis_y_mm).surface(shell.spacing_mm))
    wall = ClosestPoint(skin.vertices, skin.faces)
    vertices = np.array(core.vertices)
    near = np.flatnonzero(cKDTree(skin.vertices).query(vertices)[0] < 2.0 * shell.spacing_mm * MM)
    for _ in range(3):  # a move off one wall can bring a vertex near another
        on, _, face = wall(vertices[near])
        inwards = -skin.face_normals[face]
        missing = clearance * MM - np.einsum("ij,ij->i", vertices[near] - on, inwards)
        vertices[near] += np.maximum(missing, 0.0)[:, None] * inwards
        near = near[missing > 0.0]
    return trimesh.Trimesh(vertices, core.faces, process=False)
