"""Pairing: contacts that are sampled once in the shared frame, and the poses that bring every sensor to them.

Contacts come from a low-discrepancy sequence over the developed (unrolled) skin of the reference sensor, see
`developed_skin`. The transform of `unfold` rolls, pitches and shifts another sensor, so that the point at the same
place of its own developed skin meets the contact with the same normal.

Shared frame, metres: x along the finger, pad side -y, z lateral.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import scipy.spatial

from simgen.config.trajectories import Trajectories
from simgen.errors import InputError
from simgen.geometry.curved_tetrahedra import CORE
from simgen.geometry.developed_skin import skin_of
from simgen.geometry.rotations import least_rotations, roll_then_pitch
from simgen.geometry.surface import ClosestPoint, FinePieces
from simgen.sensors.least_thickness import LeastThickness
from simgen.sensors.sensor import Sensor

BLOCK = 256  # contacts drawn at a time: a power of two, as Sobol sequences need
MOST_BLOCKS = 16  # proposed at a time
SLICE = 32  # least number of contacts at a time for which the gel under the indenters is measured
MOST_PROPOSED = 200  # proposals per contact found, after 16 blocks; beyond that there is too little room
WALL_TURN_DEG = (60.0, 120.0)  # angles between a side wall's normal and the contact's; the back has larger ones


@dataclass(frozen=True)
class Contacts:
    """n contacts on the reference sensor, shared frame, m and rad."""

    points: np.ndarray  # (n, 3)
    normals: np.ndarray  # (n, 3) outward
    axes: np.ndarray  # (n, 3) press directions, into the sensor
    rolls: np.ndarray  # (n,) about the press direction
    arcs: np.ndarray  # (n,) lateral arc length from the centre line


@dataclass(frozen=True)
class Draw:
    """Contacts that were drawn, up to the last one that is kept."""

    kept: Contacts
    refused: Contacts  # an indenter would leave too little gel there


def sample_contacts(
    reference: Sensor,
    count: int,
    seed: int,
    max_depth_m: float,
    settings: Trajectories | None = None,
    others: Sequence[Sensor] = (),
    lateral_reach_m: float = 0.0,
) -> Contacts:
    """Draw contacts as `draw_contacts` does, without the rule on thin gel."""
    return draw_contacts(reference, count, seed, max_depth_m, settings, others, lateral_reach_m).kept


def draw_contacts(
    reference: Sensor,
    count: int,
    seed: int,
    max_depth_m: float,
    settings: Trajectories | None = None,
    others: Sequence[Sensor] = (),
    lateral_reach_m: float = 0.0,
    indented: Sequence[LeastThickness] = (),
) -> Draw:
    """Draw ``count`` contacts on ``reference``, each with room for the deepest press and a partner on all ``others``.

    Paths that move sideways by ``lateral_reach_m`` need that much more distance from side walls. Contacts where an
    indenter leaves less than ``least_thickness_left`` of a sensor's gel are refused, and others are drawn.
    ``indented`` measures this on ``reference`` and on each of ``others``; without it the rule is off. Contacts are a
    scrambled Sobol sequence in (x, arc, tilt, azimuth, roll) with rejection, so the first n contacts do not depend on
    ``count``. Raises InputError if there is too little room, or if there are too few partners.
    """
    from scipy.stats import qmc  # takes a third of a second, so processes that only press do not import it

    settings = settings or Trajectories(count=count)
    sensors = (reference, *others)
    room, *others = [Room(sensor, max_depth_m, settings, lateral_reach_m) for sensor in sensors]
    if not settings.least_thickness_left:
        indented = ()
    sequence = qmc.Sobol(5, scramble=True, rng=seed)
    fitting, enough = [], []  # proposals with room and partners, and masks: enough gel is left
    found = roomy = partnered = proposed = 0
    while found < count:
        if proposed >= 16 * BLOCK and proposed > MOST_PROPOSED * found:
            raise InputError(_too_few(room, others, count, (found, partnered, roomy, proposed)))
        blocks = _blocks(count, found, proposed)
        some = room.keep(room.propose(np.concatenate([sequence.random(BLOCK) for _ in range(blocks)])))
        roomy += len(some.points)
        for other in others:
            some = _subset(some, other.meets(some))
        partnered += len(some.points)
        proposed += blocks * BLOCK
        presses = [
            np.linalg.inv(unfold(reference, sensor, some)) @ indenter_poses(some)
            for sensor, _ in zip(sensors, indented, strict=False)
        ]
        first = 0
        while first < len(some.points) and found < count:
            part = slice(first, first + max(SLICE, count - found))
            fitting.append(_subset(some, part))
            enough.append(np.ones(len(fitting[-1].points), dtype=bool))
            for thickness, poses in zip(indented, presses, strict=False):
                shares = thickness.shares(poses[part][enough[-1]])
                enough[-1][enough[-1]] = (shares >= settings.least_thickness_left).all(axis=1)
            found += int(enough[-1].sum())
            first = part.stop
    kept = np.concatenate(enough)
    drawn = np.arange(len(kept)) <= np.flatnonzero(kept)[count - 1]
    contacts = Contacts(**{
        field.name: np.concatenate([getattr(some, field.name) for some in fitting]) for field in fields(Contacts)
    })  # fmt: skip
    return Draw(_subset(contacts, drawn & kept), _subset(contacts, drawn & ~kept))


def _blocks(count: int, found: int, proposed: int) -> int:
    """Number of blocks to propose next: about as many as are missing, but no more than were proposed before.

    With many contacts at a time, all cores measure the gel under the indenters. Proposals that are not needed cost time
    for nothing.
    """
    if not found:
        return 1
    missing = -(-(count - found) * proposed // (found * BLOCK))
    return min(missing, proposed // BLOCK, MOST_BLOCKS)


def _subset(contacts: Contacts, kept: np.ndarray | slice) -> Contacts:
    return Contacts(**{field.name: getattr(contacts, field.name)[kept] for field in fields(Contacts)})


def _too_few(room: "Room", others: Sequence["Room"], count: int, counts: tuple[int, int, int, int]) -> str:
    """Error line; counts: contacts found, with partners, with room, and proposed."""
    found, partnered, roomy, proposed = counts
    line = (
        f"{room.name}: {found} of {count} contacts fit after {proposed} proposals of presses of "
        f"{room.max_depth * 1e3:g} mm with max_indentation_ratio {room.settings.max_indentation_ratio:g} and "
        f"min_edge_ratio {room.settings.min_edge_ratio:g}; "
    )
    if partnered > 2 * found:
        return line + (
            f"{partnered} contacts fit otherwise, but an indenter leaves less than least_thickness_left "
            f"{room.settings.least_thickness_left:g} of the gel there, or enters the support; press less deep, tilt "
            "less, leave out the widest indenters, allow a smaller least_thickness_left (0: off), or end such presses "
            "early (too_thin: stop)"
        )
    if roomy > 2 * partnered:
        names = " and ".join(other.name for other in others)
        return line + f"{roomy} contacts have room, but most have no partner on {names}; put the smallest sensor first"
    advice = "press less deep, or allow a larger max_indentation_ratio or a smaller min_edge_ratio"
    if room.lateral_reach:
        advice += f"; the path goes {room.lateral_reach * 1e3:.3g} mm sideways, shorten it"
    return line + advice


def indenter_poses(contacts: Contacts) -> np.ndarray:
    """Poses (n, 4, 4), indenter frame -> shared frame: tip at the contact point, +y along the press direction.

    At roll 0 the axes are those of the shared frame after the least rotation of +y to the press direction.
    """
    poses = np.tile(np.eye(4), (len(contacts.points), 1, 1))
    cos, sin = np.cos(contacts.rolls), np.sin(contacts.rolls)
    roll = np.tile(np.eye(3), (len(cos), 1, 1))
    roll[:, 0, 0], roll[:, 0, 2], roll[:, 2, 0], roll[:, 2, 2] = cos, sin, -sin, cos
    poses[:, :3, :3] = least_rotations(contacts.axes) @ roll
    poses[:, :3, 3] = contacts.points
    return poses


def unfold(reference: Sensor, other: Sensor, contacts: Contacts) -> np.ndarray:
    """Poses (n, 4, 4) of ``other``, its own frame -> shared frame, one for each contact on ``reference``.

    The rotation is a roll about x, then a pitch about z, without yaw. Raises InputError if ``other`` has no partner for
    a contact.
    """
    poses = np.tile(np.eye(4), (len(contacts.points), 1, 1))
    if other is reference:
        return poses
    points, normals = partners(other, contacts)
    rotations = roll_then_pitch(normals, contacts.normals)
    turnable = np.isfinite(rotations[:, 0, 0])
    if not turnable.all():
        place = _place(contacts, turnable.argmin())
        raise InputError(f"{other.name}: no roll and pitch bring its normal to that of contact {place}")
    poses[:, :3, :3] = rotations
    poses[:, :3, 3] = contacts.points - (rotations @ points[:, :, None])[:, :, 0]
    return poses


def partners(other: Sensor, contacts: Contacts) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) and outward normals (n, 3) on ``other`` at the contacts' (x, arc), in its own frame.

    Raises InputError if ``other`` has no partner for a contact.
    """
    points, normals = skin_of(other.surface).points(contacts.points[:, 0], contacts.arcs)
    on_skin = np.isfinite(points[:, 0])
    if not on_skin.all():
        raise InputError(f"{other.name}: its skin has no partner for contact {_place(contacts, on_skin.argmin())}")
    return points, normals


def _place(contacts: Contacts, i: int) -> str:
    return f"{i} (x = {contacts.points[i, 0] * 1e3:.2f} mm, lateral arc {contacts.arcs[i] * 1e3:.2f} mm)"


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
        surface, bounds, normals = sensor.surface, sensor.surface.triangles, sensor.surface.face_normals
        self.surface, self.surface_normals = FinePieces(bounds), normals
        self.inner_skin = None
        if sensor.core is not None:
            wall = sensor.surface_region == CORE
            self.inner_skin = ClosestPoint(surface.vertices, surface.faces[wall])
            # Bounds of the room for a press: the gel's surface without its inner side, and the core from outside.
            bounds = np.concatenate([bounds[~wall], sensor.core.triangles])
            normals = np.concatenate([normals[~wall], -sensor.core.face_normals])
        self.bounds, self.bound_normals = FinePieces(bounds), normals

    def propose(self, uniform: np.ndarray) -> Contacts:
        """Contacts on the skin from points (n, 5) of the unit cube, without those off the skin."""
        x = self.x_range[0] + uniform[:, 0] * (self.x_range[1] - self.x_range[0])
        arcs = self.max_arc * (2.0 * uniform[:, 1] - 1.0)
        points, normals = self.skin.points(x, arcs)
        on_skin = np.isfinite(points[:, 0])
        points, normals = points[on_skin], normals[on_skin]
        # Uniform over the cap of directions around the inward normal.
        cos = 1.0 - uniform[on_skin, 2] * (1.0 - np.cos(np.radians(self.settings.max_tilt_deg)))
        azimuth = 2.0 * np.pi * uniform[on_skin, 3]
        sin = np.sqrt(1.0 - cos**2)
        local = np.stack([sin * np.cos(azimuth), cos, sin * np.sin(azimuth)], axis=1)
        axes = np.einsum("nij,nj->ni", least_rotations(-normals), local)
        first, last = np.radians(self.settings.roll_range_deg)
        return Contacts(points, normals, axes, first + uniform[on_skin, 4] * (last - first), arcs[on_skin])

    def keep(self, contacts: Contacts) -> Contacts:
        """Contacts that are touchable, on a thick enough gel, and far enough from side walls."""
        kept = self._is_touchable(contacts.points)
        kept[kept] = self._is_thick(contacts.points[kept], contacts.normals[kept])
        kept[kept] = ~self._is_beside_a_wall(contacts.points[kept], contacts.normals[kept])
        return _subset(contacts, kept)

    def meets(self, contacts: Contacts) -> np.ndarray:
        """True (n,) for contacts of another sensor whose partner here is touchable and far enough from side walls."""
        points, normals = self.skin.points(contacts.points[:, 0], contacts.arcs)
        meets = np.isfinite(roll_then_pitch(normals, contacts.normals)[:, 0, 0])
        meets[meets] = self._is_touchable(points[meets])
        meets[meets] = ~self._is_beside_a_wall(points[meets], normals[meets])
        return meets

    def _is_touchable(self, points: np.ndarray) -> np.ndarray:
        return self.touchable[self.nearest.query(points)[1]]

    def _needed_thickness(self, points: np.ndarray) -> np.ndarray:
        """Diameters (n,) m of the balls that must fit under contacts at points (n, 3)."""
        if self.inner_skin is None:
            return np.full(len(points), self.solid_thickness)
        skin = np.minimum(self.inner_skin(points)[1], self.solid_thickness)
        return self.max_depth + (1.0 - self.settings.max_indentation_ratio) * skin

    def _is_thick(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """True (n,) if no boundary is inside the ball of the needed thickness that touches the contact from inside.

        Facets next to the contact do not count, because they always cut into the ball.
        """
        radii = 0.5 * self._needed_thickness(points)
        centres = points - radii[:, None] * normals
        pieces, ball, owner = self.bounds.near(centres, radii, 0.5 * radii)
        inside = _within(pieces, centres[ball], radii[ball])
        next_to_it = _within(pieces, points[ball], 0.5 * radii[ball])
        turned_alike = np.vecdot(self.bound_normals[owner], normals[ball]) >= 0.0
        is_thick = np.ones(len(points), dtype=bool)
        is_thick[ball[(inside & ~(next_to_it & turned_alike[:, None])).any(axis=1)]] = False
        return is_thick

    def _is_beside_a_wall(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
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


def _within(points: np.ndarray, centres: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """True (n, k) for points (n, k, 3) that are in balls with centres (n, 3) and radii (n,)."""
    squares = (points - centres[:, None]) ** 2
    return np.sqrt(squares[..., 0] + squares[..., 1] + squares[..., 2]) <= radii[:, None]  # faster than np.linalg.norm
