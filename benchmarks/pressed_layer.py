"""A sphere pressed into a bonded layer: meshes, simgen's press and the reference, for `peers_gpu`."""

import time

import numpy as np

from simgen.geometry.rigid_shape import rigid_shape
from simgen.geometry.signed_distance import Kind
from simgen.sensors.sensor import Material
from simgen.simulation.press import Scene, press
from simgen.units import MM_PER_M, UM_PER_M
from simgen.verification.validate.layer_meshes import graded, round_layer
from simgen.verification.validate.layer_press import LayerMeshSize, layer_gel, quarter_layer
from simgen.verification.validate.layer_reference import HEIGHT_MM, RADIUS_MM
from simgen.verification.validate.meshes import Mesh

SPHERE_MM, DEPTH_MM, NEAR_MM = 3.5, 1.0, 6.0  # errors of the surface count within NEAR_MM of the axis
REFERENCE = LayerMeshSize(0.15, until=2.5, growth=0.1, top=0.15)
RADII_MM = np.linspace(0.0, NEAR_MM, 121)


def layer(edge: float) -> Mesh:
    """Whole layer, its top at y = 0 facing -y, with edges of nearly equal length, mm."""
    levels = graded(HEIGHT_MM, edge, HEIGHT_MM, 0.0)
    return round_layer(graded(RADIUS_MM, edge, RADIUS_MM, 0.0), levels, segments=64, quarters=4)


def gel(nu: float) -> Material:
    """The reference's material without friction, with another Poisson's ratio."""
    return layer_gel(0.0).model_copy(update={"poisson_ratio": nu})


def solve(scene: Scene, batch: int) -> tuple[list, float]:
    """Press the sphere in one step; returns the results and the seconds."""
    shapes, poses = [rigid_shape(Kind.SPHERE, SPHERE_MM)] * batch, np.tile(np.eye(4), (batch, 1, 1))
    begin = time.perf_counter()
    results = press(scene, shapes, poses, np.array([DEPTH_MM / MM_PER_M]))
    return results, time.perf_counter() - begin


class Reference:
    """Force (N) and surface of simgen on a fine quarter of the layer."""

    def __init__(self, nu: float, device: str):
        [result], _ = solve(Scene(quarter_layer(REFERENCE, RADII_MM), gel(nu), device=device), 1)
        self.force = 4.0 * abs(float(result.force[-1, 1]))  # on a quarter, other components balance the symmetry
        along_x = result.displacement[-1].reshape(-1, len(RADII_MM), 3)[0] * MM_PER_M
        self._outwards, self._inwards = along_x[:, 0], along_x[:, 1]

    def error_um(self, points: np.ndarray, moved: np.ndarray) -> float:
        """Root mean square of the distance of surface points (p, 3) mm, moved by (p, 3) mm, from the reference."""
        r = np.hypot(points[:, 0], points[:, 2])
        near = r < NEAR_MM
        direction = points[:, [0, 2]] / np.maximum(r, 1e-9)[:, None]
        expected = np.interp(r, RADII_MM, self._outwards)[:, None] * direction
        expected = np.column_stack([expected[:, 0], np.interp(r, RADII_MM, self._inwards), expected[:, 1]])
        return float(np.sqrt(((moved - expected)[near] ** 2).sum(axis=1).mean()) * UM_PER_M / MM_PER_M)
