"""Room for contacts on a sensor: places that are touchable, on a thick enough gel, and far enough from side walls."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields

import numpy as np
import scipy.spatial

from simgen.config.trajectories import Trajectories
from simgen.geometry.developed_skin import Skin, skin_of
from simgen.geometry.rotations import least_rotations, roll_then_pitch
from simgen.sensors.sensor import Sensor

WALL_TURN_DEG = (60.0, 120.0)  # angles between a side wall's normal and the contact's; the back has larger ones

LEAST_PART, MOST_THREADS = 64, 8  # least number of contacts that a thread tests; most threads


@dataclass(frozen=True)
class Contacts:
    """n contacts on the reference sensor, shared frame, m and rad."""

    points: np.ndarray  # (n, 3)
    normals: np.ndarray  # (n, 3) outward
    axes: np.ndarray  # (n, 3) press directions, into the sensor
    rolls: np.ndarray  # (n,) about the press direction
    arcs: np.ndarray  # (n,) lateral arc length from the centre line


def subset(contacts: Contacts, kept: np.ndarray | slice) -> Contacts:
    """Some of the contacts: a mask (n,) bool, or a slice."""
    return Contacts(**{field.name: getattr(contacts, field.name)[kept] for field in fields(Contacts)})


def contacts_at(
    skin: Skin, x: np.ndarray, arcs: np.ndarray, cos_tilts: np.ndarray, azimuths: np.ndarray, rolls: np.ndarray
) -> Contacts:
    """Contacts at places (n,) m of a developed skin, without those off the skin.

    cos_tilts, azimuths : (n,) cosines of the angles between press axis and inward normal; rad, turn of the axis about
        that normal
    rolls : (n,) rad, turns of the indenter about the press axis
    """
    points, normals = skin.points(x, arcs)
    on_skin = np.isfinite(points[:, 0])
    points, normals = points[on_skin], normals[on_skin]
    cos, azimuths = cos_tilts[on_skin], azimuths[on_skin]
    sin = np.sqrt(1.0 - cos**2)
    local = np.stack([sin * np.cos(azimuths), cos, sin * np.sin(azimuths)], axis=1)
    axes = np.einsum("nij,nj->ni", least_rotations(-normals), local)
    return Contacts(points, normals, axes, rolls[on_skin], arcs[on_skin])


class Room:
    """Places on a sensor that have room for a contact.

    A gel bonded to a rigid back allows presses of up to ``max_indentation_ratio`` of its local thickness. The thickness
    is the diameter of the largest ball that touches the surface at the contact from inside and fits into the gel.

    A skin over a core allows deeper presses. It bends across the gap until it meets the core, and only the rest of the
    press squeezes it. So a skin of thickness s over a gap g allows a depth of g + ratio s. A press of depth d then
    needs a ball of diameter s + g = d + (1 - ratio) s between the contact and the core. A gap with fluid counts as
    one without, because the fluid flows aside.
    """

    def __init__(self, sensor: Sensor, max_depth_m: float, settings: Trajectories, lateral_reach_m: float = 0.0):
        self.name, self.settings, self.max_depth = sensor.name, settings, max_depth_m
        self.skin = skin_of(sensor.surface)
        mesh = sensor.output_mesh
        on_surface = mesh.surface_vertices
        self.touchable = mesh.touchable[on_surface]
        self.nearest = scipy.spatial.cKDTree(mesh.vertices[on_surface])
        low, high = mesh.vertices[mesh.touchable].min(axis=0), mesh.vertices[mesh.touchable].max(axis=0)
        self.x_range = low[0], high[0]
        # A convex section's arc from the centre line is no longer than its width and height together.
        self.max_arc = np.abs([low[2], high[2]]).max() + high[1] - low[1]
        self.solid_thickness = max_depth_m / settings.max_indentation_ratio
        self.edge_distance = settings.min_edge_ratio * max_depth_m + lateral_reach_m
        self.wall_piece = 0.25 * (self.solid_thickness + lateral_reach_m)
        self.lateral_reach = lateral_reach_m
        self.inner_side, self.bounds = sensor.inner_side, sensor.bounds
        self.surface, self.surface_normals = sensor.pieces, sensor.surface.face_normals

    def propose(self, uniform: np.ndarray) -> Contacts:
        """Contacts on the skin from points (n, 5) of the unit cube, without those off the skin."""
        x = self.x_range[0] + uniform[:, 0] * (self.x_range[1] - self.x_range[0])
        arcs = self.max_arc * (2.0 * uniform[:, 1] - 1.0)
        # Uniform over the cap of directions around the inward normal.
        cos = 1.0 - uniform[:, 2] * (1.0 - np.cos(np.radians(self.settings.max_tilt_deg)))
        first, last = np.radians(self.settings.roll_range_deg)
        rolls = first + uniform[:, 4] * (last - first)
        return contacts_at(self.skin, x, arcs, cos, 2.0 * np.pi * uniform[:, 3], rolls)

    def keep(self, contacts: Contacts) -> Contacts:
        """Contacts that are touchable, on a thick enough gel, and far enough from side walls."""
        kept = self.is_touchable(contacts.points)
        kept[kept] = _in_threads(self.is_thick, contacts.points[kept], contacts.normals[kept])
        kept[kept] = ~_in_threads(self.is_beside_a_wall, contacts.points[kept], contacts.normals[kept])
        return subset(contacts, kept)

    def meets(self, contacts: Contacts) -> np.ndarray:
        """True (n,) for contacts of another sensor whose partner here is touchable and far enough from side walls."""
        points, normals = self.skin.points(contacts.points[:, 0], contacts.arcs)
        meets = np.isfinite(roll_then_pitch(normals, contacts.normals)[:, 0, 0])
        meets[meets] = self.is_touchable(points[meets])
        meets[meets] = ~_in_threads(self.is_beside_a_wall, points[meets], normals[meets])
        return meets

    def is_touchable(self, points: np.ndarray) -> np.ndarray:
        """True (n,) for points (n, 3) m next to a touchable vertex."""
        return self.touchable[self.nearest.query(points)[1]]

    def _needed_thickness(self, points: np.ndarray) -> np.ndarray:
        """Diameters (n,) m of the balls that must fit under contacts at points (n, 3)."""
        if self.inner_side is None:
            return np.full(len(points), self.solid_thickness)
        skin = np.minimum(self.inner_side(points)[1], self.solid_thickness)
        return self.max_depth + (1.0 - self.settings.max_indentation_ratio) * skin

    def is_thick(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """True (n,) if no boundary is inside the ball of the needed thickness that touches the contact from inside.

        Facets next to the contact do not count, because they always cut into the ball.
        """
        radii = 0.5 * self._needed_thickness(points)
        centres = points - radii[:, None] * normals
        bounds, bound_normals = self.bounds
        pieces, ball, owner = bounds.near(centres, radii, 0.5 * radii)
        inside = _within(pieces, centres[ball], radii[ball])
        next_to_it = _within(pieces, points[ball], 0.5 * radii[ball])
        turned_alike = np.vecdot(bound_normals[owner], normals[ball]) >= 0.0
        is_thick = np.ones(len(points), dtype=bool)
        is_thick[ball[(inside & ~(next_to_it & turned_alike[:, None])).any(axis=1)]] = False
        return is_thick

    def is_beside_a_wall(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """True (n,) if a side wall's facet is nearer than the edge distance."""
        high, low = np.cos(np.radians(WALL_TURN_DEG))

        def is_wall(ball: np.ndarray, triangle: np.ndarray) -> np.ndarray:
            cosine = np.vecdot(self.surface_normals[triangle], normals[ball])
            return (cosine < high) & (cosine > low)

        distance, longest = (np.full(len(points), size) for size in (self.edge_distance, self.wall_piece))
        pieces, ball, _ = self.surface.near(points, distance, longest, is_wall)
        beside = np.zeros(len(points), dtype=bool)
        beside[ball[_within(pieces.mean(axis=1, keepdims=True), points[ball], distance[ball])[:, 0]]] = True
        return beside


def _in_threads(
    test: Callable[[np.ndarray, np.ndarray], np.ndarray], points: np.ndarray, normals: np.ndarray
) -> np.ndarray:
    """Mask (n,) of a test of points and normals (n, 3), which threads test part by part."""
    threads = min(MOST_THREADS, os.cpu_count() or 1, -(-len(points) // LEAST_PART))
    if threads < 2:
        return test(points, normals)
    with ThreadPoolExecutor(threads) as pool:
        parts = pool.map(test, np.array_split(points, threads), np.array_split(normals, threads))
        return np.concatenate(list(parts))


def _within(points: np.ndarray, centres: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """True (n, k) for points (n, k, 3) that are in balls with centres (n, 3) and radii (n,)."""
    squares = (points - centres[:, None]) ** 2
    return np.sqrt(squares[..., 0] + squares[..., 1] + squares[..., 2]) <= radii[:, None]  # faster than np.linalg.norm
