"""Press of a sphere into a quarter of the round layer: force, surface, contact radius, pressure. Lengths in mm."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from simgen.fem.nonlinear.status import has_values
from simgen.geometry.rigid_shape import rigid_shape, signed_distance
from simgen.geometry.signed_distance import Kind
from simgen.sensors.sensor import Material, Sensor
from simgen.simulation.press import PressResult, Scene, Status, press
from simgen.units import MM_PER_M, UM_PER_M
from simgen.verification.validate.layer_meshes import (
    fixed_symmetric,
    graded,
    make_sensor,
    points_on_top,
    round_layer,
)
from simgen.verification.validate.layer_reference import HEIGHT_MM, MODULUS_MPA, POISSON_RATIO, RADIUS_MM
from simgen.verification.validate.meshes import top

QUARTERS = 4  # quarters of the whole layer
SEGMENTS = 4  # segments of a quarter ring
AZIMUTHS = np.radians([0.0, 22.5, 45.0, 67.5, 90.0])
MOVED_MM = 0.01  # displacement from which a point belongs to the deformation region
APART_MM = 0.003  # gap from which the surface is out of contact: a few times the pointwise overlap


@dataclass(frozen=True)
class LayerMeshSize:
    """Edge lengths of a mesh of the layer.

    edge, until, growth : edge length up to the radius ``until``, and its increase per mm beyond
    top : thickness of the uppermost layer of elements
    segments : largest number in a quarter ring; few are enough for a round solution
    """

    edge: float
    until: float
    growth: float
    top: float
    segments: int = SEGMENTS

    def coarser(self, factor: float) -> "LayerMeshSize":
        """Scale all edges by a factor."""
        return LayerMeshSize(factor * self.edge, self.until, factor * self.growth, factor * self.top, self.segments)


@dataclass(frozen=True)
class LayerPress:
    """Solution of a press on one mesh, at d depths and p radii.

    force : (d,) N, on the whole layer
    displacement : (d, azimuths, p, 3) mm: outwards, into the layer, around the axis
    rings, pressure : rest radii (r,) of the rings of corner nodes, and the contact multipliers of each ring at the last
        depth, MPa per rest area
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
        """Index of the nearest depth."""
        return int(np.abs(self.depths - depth).argmin())

    def overlap_um(self) -> float:
        """Root mean square of the gap in the contact at the last depth, um."""
        return float(self.result.certificate["rms_penetration_m"][-1] * UM_PER_M)


def quarter_layer(size: LayerMeshSize, radii: np.ndarray, radius: float = RADIUS_MM) -> Sensor:
    """Make the quarter of the layer; its output vertices are surface points at all radii and `AZIMUTHS`."""
    levels = graded(HEIGHT_MM, size.top, size.top, 0.25)
    mesh = round_layer(graded(radius, size.edge, size.until, size.growth), levels, size.segments)
    fixed = fixed_symmetric(mesh, (0, 2), HEIGHT_MM)
    return make_sensor(mesh, fixed, top(mesh.nodes, mesh.faces), points_on_top(AZIMUTHS, radii))


def layer_gel(friction: float) -> Material:
    """Material of the reference layer."""
    return Material(
        youngs_modulus_pa=MODULUS_MPA * 1e6, poisson_ratio=POISSON_RATIO, friction=friction, source="the reference's"
    )


def check_reached(status: np.ndarray, name: Callable[[int], str]) -> None:
    """Raise RuntimeError for the first step that did not converge, by its ``name`` and the reason."""
    if not has_values(status).all():
        failed = int(has_values(status).argmin())
        raise RuntimeError(f"{name(failed)} was not reached: {Status(status[failed]).sentence}")


def press_layer(
    size: LayerMeshSize,
    sphere: float,
    friction: float,
    depths: np.ndarray,
    radii: np.ndarray,
    device: str,
    radius: float = RADIUS_MM,
) -> LayerPress:
    """Press a sphere to all depths. Raises RuntimeError if a depth does not converge."""
    scene = Scene(quarter_layer(size, radii, radius), layer_gel(friction), device=device)
    result = press(scene, [rigid_shape(Kind.SPHERE, sphere)], np.eye(4)[None], np.asarray(depths) / MM_PER_M)[0]
    check_reached(result.status, lambda i: f"{depths[i]:g} mm")
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
    """Components (..., azimuths, p, 3) outwards, along y, around y, from x, y, z."""
    cos, sin = np.cos(AZIMUTHS)[:, None], np.sin(AZIMUTHS)[:, None]
    x, y, z = np.moveaxis(moved, -1, 0)
    return np.stack([x * cos + z * sin, y, z * cos - x * sin], axis=-1)


def ring_pressures(scene: Scene) -> tuple[np.ndarray, list[np.ndarray]]:
    """Group the present contact multipliers, MPa, by rings of corner nodes: rest radii and values."""
    contact = scene.indenter_contact
    corners = scene.nodes[np.unique(contact.host_faces[:, :3])]  # the order of the multipliers
    values = contact.surface.normal.numpy()[:, 0] * MODULUS_MPA
    radius, ring = np.unique(np.hypot(corners[:, 0], corners[:, 2]).round(6), return_inverse=True)
    return radius, [values[ring == i] for i in range(len(radius))]


def contact_radius(pressed: LayerPress, depth: float, apart: float = APART_MM) -> float:
    """Largest deformed radius at which the surface, averaged over azimuths, lies within ``apart`` of the sphere."""
    u = pressed.displacement[pressed.at(depth)]
    radius = pressed.radii + u[..., 0]
    points = np.stack([radius, u[..., 1] - depth, u[..., 2]], axis=-1)
    shape = rigid_shape(Kind.SPHERE, pressed.sphere)
    gap = signed_distance(shape, points.reshape(-1, 3))[0].reshape(radius.shape).mean(axis=0)
    return float(radius.mean(axis=0)[gap <= apart].max())


def surface_error(pressed: LayerPress, depth: float, profile: np.ndarray) -> float:
    """Root mean square of the difference to a profile (k, 3) of r, u_r, u_y, over the deformation region.

    The weight of a radius is the area of its annulus, which reaches half-way to the neighbours. All azimuths weigh the
    same. The profile has no displacement around the axis.
    """
    r, expected = profile[:, 0], np.insert(profile[:, 1:], 2, 0.0, axis=1)
    ours = pressed.displacement[pressed.at(depth)][:, np.searchsorted(pressed.radii, r - 1e-9)]
    middles = np.concatenate([[0.0], 0.5 * (r[1:] + r[:-1]), r[-1:]])
    moved = np.linalg.norm(expected, axis=1) >= MOVED_MM
    weight = np.where(moved, np.diff(middles**2), 0.0)
    squared = ((ours - expected) ** 2).sum(axis=-1).mean(axis=0)
    return float(np.sqrt((weight * squared).sum() / weight.sum()))


def pressure_swing(pressed: LayerPress) -> float:
    """Area-weighted rms distance of multipliers from the line between the neighbouring rings, over the centre's value.

    The contact's last ring is left out, because its multipliers average points in and out of contact.
    """
    mean = np.array([values.mean() for values in pressed.pressure])
    last = int(np.flatnonzero(mean > 0.1 * mean[0])[-1])
    r = pressed.rings
    inner, i, outer = np.arange(last - 1), np.arange(1, last), np.arange(2, last + 1)
    share = (r[i] - r[inner]) / (r[outer] - r[inner])
    line = (1.0 - share) * mean[inner] + share * mean[outer]
    squared = [((values - at) ** 2).mean() for values, at in zip(pressed.pressure[1:last], line, strict=True)]
    return float(np.sqrt(np.average(squared, weights=r[i] * (r[outer] - r[inner]))) / mean[0])
