"""A press of a sphere into the quarter of a round layer, and what is measured on it. Lengths in mm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simgen.fem.nonlinear.status import has_values
from simgen.geometry.rigid_shape import rigid_shape, signed_distance
from simgen.geometry.signed_distance import Kind
from simgen.sensors.sensor import Material, Sensor
from simgen.simulation.press import PressResult, Scene, Status, press
from simgen.units import MM_PER_M
from simgen.verification.validate.layer_meshes import graded, make_sensor, round_layer
from simgen.verification.validate.layer_reference import HEIGHT_MM, MODULUS_MPA, POISSON_RATIO, RADIUS_MM
from simgen.verification.validate.meshes import on_plane, top

QUARTERS = 4  # of the whole layer: the force on one counts so often
SEGMENTS = 4  # of a quarter of a ring
AZIMUTHS = np.radians([0.0, 22.5, 45.0, 67.5, 90.0])
MOVED_MM = 0.01  # the deformation region: what has moved this far
APART_MM = 0.003  # a surface further than this from the sphere has left it: a few times the pointwise overlap


@dataclass(frozen=True)
class LayerMeshSize:
    """Edges: ``edge`` under the contact, ``growth`` more per mm beyond ``until``; ``top`` of the uppermost layer.

    segments : of a quarter of a ring, at most; few are enough for a solution that is round
    """

    edge: float
    until: float
    growth: float
    top: float
    segments: int = SEGMENTS

    def coarser(self, factor: float) -> LayerMeshSize:
        return LayerMeshSize(factor * self.edge, self.until, factor * self.growth, factor * self.top, self.segments)


@dataclass(frozen=True)
class LayerPress:
    """One press on one mesh; d depths, p radii.

    force : (d,) N, on the whole layer
    displacement : (d, azimuths, p, 3) mm: outwards, into the layer, around the axis
    rings, pressure : rest radii (r,) of the rings of corner nodes; contact multipliers of each, MPa per rest area, at
        the last depth
    """

    unknowns: int
    sphere: float
    depths: np.ndarray
    radii: np.ndarray
    force: np.ndarray
    displacement: np.ndarray
    rings: np.ndarray
    pressure: list[np.ndarray]
    result: PressResult

    def at(self, depth: float) -> int:
        return int(np.abs(self.depths - depth).argmin())

    def overlap_um(self) -> float:
        """Root mean square of the gap over the contact at the last depth."""
        return float(self.result.certificate["rms_penetration_m"][-1] * 1e6)


def quarter_layer(size: LayerMeshSize, radii: np.ndarray, radius: float = RADIUS_MM) -> Sensor:
    """The layer between two planes of symmetry; its output are surface points at all radii and `AZIMUTHS`."""
    levels = graded(HEIGHT_MM, size.top, size.top, 0.25)
    mesh = round_layer(graded(radius, size.edge, size.until, size.growth), levels, size.segments)
    fixed = np.zeros(mesh.nodes.shape, dtype=bool)
    for axis in (0, 2):
        fixed[on_plane(mesh.nodes, axis, 0.0), axis] = True
    fixed[on_plane(mesh.nodes, 1, HEIGHT_MM)] = True
    x, z = np.outer(np.cos(AZIMUTHS), radii), np.outer(np.sin(AZIMUTHS), radii)
    points = np.stack([x, np.zeros_like(x), z], axis=-1).reshape(-1, 3)
    return make_sensor(mesh, fixed, top(mesh.nodes, mesh.faces), points)


def press_layer(
    size: LayerMeshSize,
    sphere: float,
    friction: float,
    depths: np.ndarray,
    radii: np.ndarray,
    device: str,
    radius: float = RADIUS_MM,
) -> LayerPress:
    """Press a sphere through all depths; see `quarter_layer`. Raises RuntimeError where the solver gives up."""
    material = Material(
        youngs_modulus_pa=MODULUS_MPA * 1e6, poisson_ratio=POISSON_RATIO, friction=friction, source="the reference's"
    )
    scene = Scene(quarter_layer(size, radii, radius), material, device=device)
    result = press(scene, [rigid_shape(Kind.SPHERE, sphere)], np.eye(4)[None], np.asarray(depths) / MM_PER_M)[0]
    if not has_values(result.status).all():
        failed = int(has_values(result.status).argmin())
        raise RuntimeError(f"{depths[failed]:g} mm was not reached: {Status(result.status[failed]).sentence}")
    moved = result.displacement.reshape(len(depths), len(AZIMUTHS), len(radii), 3) * MM_PER_M
    rings, pressure = ring_pressures(scene)
    return LayerPress(
        unknowns=scene.unknowns,
        sphere=sphere,
        depths=np.asarray(depths),
        radii=radii,
        force=QUARTERS * result.force[:, 1],
        displacement=_around_axis(moved),
        rings=rings,
        pressure=pressure,
        result=result,
    )


def _around_axis(moved: np.ndarray) -> np.ndarray:
    """(..., azimuths, p, 3) from x, y, z to outwards, along y, around y."""
    cos, sin = np.cos(AZIMUTHS)[:, None], np.sin(AZIMUTHS)[:, None]
    x, y, z = np.moveaxis(moved, -1, 0)
    return np.stack([x * cos + z * sin, y, z * cos - x * sin], axis=-1)


def ring_pressures(scene: Scene) -> tuple[np.ndarray, list[np.ndarray]]:
    """Contact multipliers of the present state, MPa, for each ring of corner nodes: rest radii and values."""
    contact = scene.indenter_contact
    corners = scene.nodes[np.unique(contact.host_faces[:, :3])]  # the order of the multipliers
    values = contact.surface.normal.numpy()[:, 0] * MODULUS_MPA
    radius, ring = np.unique(np.hypot(corners[:, 0], corners[:, 2]).round(6), return_inverse=True)
    return radius, [values[ring == i] for i in range(len(radius))]


def contact_radius(pressed: LayerPress, depth: float, apart: float = APART_MM) -> float:
    """Deformed radius up to which the surface (mean over the azimuths) lies within ``apart`` of the sphere."""
    u = pressed.displacement[pressed.at(depth)]
    radius = pressed.radii + u[..., 0]
    points = np.stack([radius, u[..., 1] - depth, u[..., 2]], axis=-1)
    shape = rigid_shape(Kind.SPHERE, pressed.sphere)
    gap = signed_distance(shape, points.reshape(-1, 3))[0].reshape(radius.shape).mean(axis=0)
    return float(radius.mean(axis=0)[gap <= apart].max())


def surface_error(pressed: LayerPress, depth: float, profile: np.ndarray) -> float:
    """Root mean square, over the deformation region, of the difference to a profile (k, 3): r, u_r, u_y.

    Each radius weighs as the annulus between the middles to its neighbours, all azimuths the same; a displacement
    around the axis is all error.
    """
    r, expected = profile[:, 0], np.insert(profile[:, 1:], 2, 0.0, axis=1)
    ours = pressed.displacement[pressed.at(depth)][:, np.searchsorted(pressed.radii, r - 1e-9)]
    middles = np.concatenate([[0.0], 0.5 * (r[1:] + r[:-1]), r[-1:]])
    moved = np.linalg.norm(expected, axis=1) >= MOVED_MM
    weight = np.where(moved, np.diff(middles**2), 0.0)
    squared = ((ours - expected) ** 2).sum(axis=-1).mean(axis=0)
    return float(np.sqrt((weight * squared).sum() / weight.sum()))


def pressure_swing(pressed: LayerPress) -> float:
    """How far multipliers lie from the line between the two rings beside their own: rms, over that in the centre.

    Weighted by area. The contact's last ring is left out: its multipliers are a mean over what touches and what not.
    """
    mean = np.array([values.mean() for values in pressed.pressure])
    last = int(np.flatnonzero(mean > 0.1 * mean[0])[-1])
    r = pressed.rings
    inner, i, outer = np.arange(last - 1), np.arange(1, last), np.arange(2, last + 1)
    share = (r[i] - r[inner]) / (r[outer] - r[inner])
    line = (1.0 - share) * mean[inner] + share * mean[outer]
    squared = [((values - at) ** 2).mean() for values, at in zip(pressed.pressure[1:last], line, strict=True)]
    return float(np.sqrt(np.average(squared, weights=r[i] * (r[outer] - r[inner]))) / mean[0])
