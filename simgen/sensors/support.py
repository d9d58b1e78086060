"""The rigid support under a gel, and the gel's free faces that can reach it.

A bonded gel that is pressed near its rim bulges over the edge of its bond and meets the support there.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from simgen.errors import InputError
from simgen.geometry import mesh_files
from simgen.geometry.curved_tetrahedra import FREE, LabelledSurface
from simgen.geometry.rigid_shape import mesh_distance, sampled_distance, sampled_shape
from simgen.geometry.signed_distance import RigidShape
from simgen.geometry.tetrahedra import TRIANGLE_EDGES, SimulationMesh
from simgen.sensors.sensor_schema import SupportPlane, SupportSettings
from simgen.units import MM

SPACING_MM = 0.25  # of the grid of the signed distance, as for the core
MARGIN_MM = 3.0  # of the grid around the body
THICKNESS_MM = 5.0  # of a plate: gel beside its edge does not get below it
RESTS_MM = 0.05  # largest gap or overlap of a gel that rests on a body
# Gel can be pressed onto the support up to this distance from the bond, over the gel's height: as deep as presses go
# (default of `trajectories.max_indentation_ratio`). On the DIGIT 2.4 mm: its wall, its rim and a little of its dome.
REACH = 0.6


@dataclass(frozen=True)
class Plate:
    """A flat plate of `THICKNESS_MM`. Its outline is the gel's, grown by a margin with round corners.

    axis : 0, 1 or 2, perpendicular to the plate's face
    at_mm : where the face lies along the axis
    side : 1 or -1, the direction along the axis in which the gel lies
    outline_mm : (s, 2, 2) segments of the gel's outline in the plane, by the other two axes in order
    beyond_mm : the margin
    """

    axis: int
    at_mm: float
    side: int
    outline_mm: np.ndarray
    beyond_mm: float

    @property
    def bounds_mm(self) -> np.ndarray:
        """Lowest and highest coordinates (2, 3) mm."""
        corners = self.outline_mm.reshape(-1, 2)
        across = np.stack([corners.min(axis=0) - self.beyond_mm, corners.max(axis=0) + self.beyond_mm])
        faces = sorted([self.at_mm, self.at_mm - self.side * THICKNESS_MM])
        return np.insert(across, self.axis, faces, axis=1)

    def distance(self, points_mm: np.ndarray) -> np.ndarray:
        """Signed distance (n,) mm of points (n, 3) mm, negative inside.

        The formula for an extruded outline is Quilez's ("Distance functions", iquilezles.org). It is exact outside;
        deep inside, at corners that point inwards, it is a bound.
        """
        return self._extruded(points_mm, points_mm)

    def distance_on_grid(self, points_mm: np.ndarray) -> np.ndarray:
        """Signed distance (x, y, z) mm at the points (x, y, z, 3) mm of a grid; see `distance`."""
        return self._extruded(points_mm, points_mm.take([0], axis=self.axis))

    def _extruded(self, points_mm: np.ndarray, columns_mm: np.ndarray) -> np.ndarray:
        """Signed distance (...) mm of points (..., 3) mm in columns along the axis, given by a point of each column."""
        flat = np.delete(columns_mm, self.axis, axis=-1)
        across = distance_to_outline(flat.reshape(-1, 2), self.outline_mm).reshape(flat.shape[:-1]) - self.beyond_mm
        height = self.side * (points_mm[..., self.axis] - self.at_mm)
        along = np.abs(height + THICKNESS_MM / 2.0) - THICKNESS_MM / 2.0
        outside = np.hypot(np.maximum(across, 0.0), np.maximum(along, 0.0))
        return outside + np.minimum(np.maximum(across, along), 0.0)


@dataclass(frozen=True, eq=False)
class Support:
    """The rigid body that a gel rests on.

    body : a plate, or a closed mesh in m
    friction : Coulomb coefficient; None: the material's
    source : hash of the keys in the ``sensor.yaml`` and of the mesh file
    """

    body: Plate | trimesh.Trimesh
    friction: float | None
    source: str

    def distance(self, points_m: np.ndarray) -> np.ndarray:
        """Signed distance (n,) mm of points (n, 3) m, negative inside."""
        points = np.asarray(points_m) / MM
        return self.body.distance(points) if isinstance(self.body, Plate) else mesh_distance(self.body, points)

    def shape(self, device: str) -> RigidShape:
        """Rigid shape in the sensor's frame; its distance is sampled every `SPACING_MM`."""
        return _sampled(self, device)


@lru_cache(maxsize=4)
def _sampled(support: Support, device: str) -> RigidShape:
    """Sample a support, which takes 0.1 s: scenes of other materials, and places of contacts, need the same one."""
    body = support.body
    if isinstance(body, Plate):
        return sampled_distance(body.distance_on_grid, body.bounds_mm, SPACING_MM, MARGIN_MM)
    return sampled_shape(body, SPACING_MM, MARGIN_MM, device)


def load_support(keys: SupportSettings, folder: Path, gel: LabelledSurface) -> Support:
    """Make the support of a gel.

    Raises InputError if no triangle of the gel lies in the plane, if the gel lies on both sides of the plane, if the
    mesh file makes no closed body, or if the free surface is off the body by more than `RESTS_MM`.
    """
    path, digest = folder / "sensor.yaml", hashlib.sha256(keys.model_dump_json(exclude_none=True).encode())
    if keys.plane is not None:
        return Support(plate_under(gel.surface, keys.plane, path), keys.friction, digest.hexdigest())
    file = folder / keys.mesh.file
    body = mesh_files.bodies(mesh_files.read_mesh(file, keys.mesh.unit)[0])[0]
    digest.update(file.read_bytes())
    support = Support(body, keys.friction, digest.hexdigest())
    free = np.unique(gel.surface.faces[gel.region == FREE])
    nearest = support.distance(gel.surface.vertices[free]).min() if len(free) else 0.0
    if abs(nearest) > RESTS_MM:
        raise InputError(
            f"{path}: support.mesh.file = {keys.mesh.file!r}: the free surface of the gel comes within {nearest:.3g} "
            f"mm of it (negative: inside); allowed: -{RESTS_MM:g} to {RESTS_MM:g} mm"
        )
    return support


def plate_under(gel: trimesh.Trimesh, plane: SupportPlane, path: Path) -> Plate:
    """Lay a plate under a gel. Raises InputError as `load_support` does; ``path`` names the file in it."""
    axis = "xyz".index(plane.axis)
    height = gel.vertices[:, axis] / MM - plane.at_mm
    where = f"{path}: support.plane.at_mm = {plane.at_mm:g}"
    low, high = plane.at_mm + height.min(), plane.at_mm + height.max()
    if height.min() < -plane.within_mm and height.max() > plane.within_mm:
        allowed = f"allowed: where the gel ends, {plane.axis} = {low:.6g} or {high:.6g}"
        raise InputError(f"{where}: it cuts the gel; {allowed}")
    lies = (np.abs(height) <= plane.within_mm)[gel.faces].all(axis=1)
    if (np.abs(height) <= plane.within_mm).all():
        allowed = f"allowed: less than the gel's height, {high - low:.6g}"
        raise InputError(f"{path}: support.plane.within_mm = {plane.within_mm:g}: all of the gel lies in it; {allowed}")
    if not lies.any():
        allowed = f"allowed: a flat end of the gel, which ends at {plane.axis} = {low:.6g} and {high:.6g}"
        raise InputError(f"{where}: no triangle of the gel lies within {plane.within_mm:g} mm of it; {allowed}")
    edges = np.sort(gel.faces[lies][:, TRIANGLE_EDGES].reshape(-1, 2), axis=1)
    edges, count = np.unique(edges, axis=0, return_counts=True)
    outline = np.delete(gel.vertices[edges[count == 1]], axis, axis=2) / MM
    side = 1 if height.max() > plane.within_mm else -1
    return Plate(axis, plane.at_mm, side, outline, plane.beyond_outline_mm)


def distance_to_outline(points: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """Signed distance (n,) of points (n, 2) from closed outlines of segments (s, 2, 2); negative inside (even-odd)."""
    x, y = np.ascontiguousarray(points.T)
    nearest_2, inside = np.full(len(points), np.inf), np.zeros(len(points), dtype=bool)
    for (start_x, start_y), (end_x, end_y) in outline:
        along_x, along_y, to_x, to_y = end_x - start_x, end_y - start_y, x - start_x, y - start_y
        length_2 = along_x**2 + along_y**2  # 0 for ends that coincide
        share = np.clip((to_x * along_x + to_y * along_y) / length_2, 0.0, 1.0) if length_2 > 0.0 else 0.0
        np.minimum(nearest_2, (to_x - share * along_x) ** 2 + (to_y - share * along_y) ** 2, out=nearest_2)
        crosses = (start_y > y) != (end_y > y)
        left = (to_x * along_y < to_y * along_x) == (along_y > 0.0)
        inside ^= crosses & left
    return np.where(inside, -1.0, 1.0) * np.sqrt(nearest_2)


def faces_in_reach(support: Support, mesh: SimulationMesh) -> np.ndarray:
    """Select the free faces (f, 6) that can meet the support.

    A selected face has a corner within `REACH` times the gel's height of a resting corner. Resting corners are the free
    faces' corners on the support: the outline of the bond, or faces that lie on the support unbonded.
    """
    corners, faces = np.unique(mesh.touchable[:, :3], return_inverse=True)
    height = support.distance(mesh.nodes[corners])
    resting = mesh.nodes[corners[height <= RESTS_MM]]
    if not len(resting):
        return mesh.touchable[:0]
    near = cKDTree(resting).query(mesh.nodes[corners])[0] <= REACH * height.max() * MM
    return mesh.touchable[near[faces.reshape(-1, 3)].any(axis=1)]
