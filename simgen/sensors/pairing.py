"""One contact, sampled once in the shared frame and pressed into every sensor.

Contacts come from a low-discrepancy sequence over the developed skin of the reference sensor. Another sensor
is brought to each contact by the unfolding transform: it is pitched and rolled about its axes and shifted, so
that the point at the same place of its own developed skin (`developed_skin`) meets the contact with the same
normal.

Shared frame, metres: x along the finger, pad side -y, z lateral.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import scipy.spatial

from simgen.config.trajectories import Trajectories
from simgen.errors import InputError
from simgen.geometry.curved_tetrahedra import CORE
from simgen.geometry.developed_skin import Skin
from simgen.geometry.surface import ClosestPoint, FinePieces
from simgen.sensors.least_thickness import LeastThickness
from simgen.sensors.sensor import Sensor

BLOCK = 256  # contacts that are proposed at a time: a power of two, as a Sobol sequence wants
SLICE = 32  # of them, for which the gel under the indenters is measured at a time
MOST_PROPOSED = 200  # per contact found, once there have been 16 blocks: with less there is no room
WALL_TURN_DEG = (60.0, 120.0)  # a surface turned so far from the contact's is a side wall; more is the back


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
    """Contacts that were kept, and those before the last of them that leave too little gel under an indenter."""

    kept: Contacts
    refused: Contacts


def sample_contacts(
    reference: Sensor,
    count: int,
    seed: int,
    max_depth_m: float,
    settings: Trajectories | None = None,
    others: Sequence[Sensor] = (),
    lateral_reach_m: float = 0.0,
) -> Contacts:
    """The contacts that `draw_contacts` keeps when no indenters are known."""
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

    An indenter that moves sideways keeps ``lateral_reach_m`` more distance from side walls. Contacts where an indenter
    leaves less than ``least_thickness_left`` of a sensor's gel are drawn again; ``indented`` has the indenters on
    ``reference`` and on each of ``others``, and without it this rule is off. Contacts are a scrambled Sobol sequence in
    (x, arc, tilt, azimuth, roll), with rejection: the first n contacts do not depend on how many more are asked for.
    Raises InputError if there is too little room, or too few partners.
    """
    from scipy.stats import qmc  # a third of a second, which processes that only press do without

    settings = settings or Trajectories(count=count)
    sensors = (reference, *others)
    room, *others = rooms = [Room(sensor, max_depth_m, settings, lateral_reach_m) for sensor in sensors]
    if not settings.least_thickness_left:
        indented = ()
    sequence = qmc.Sobol(5, scramble=True, rng=seed)
    fitting, enough = [], []  # proposals that have room and partners, and if indenters leave enough gel there
    found = roomy = partnered = proposed = 0
    while found < count:
        if proposed >= 16 * BLOCK and proposed > MOST_PROPOSED * found:
            raise InputError(_too_few(room, others, count, (found, partnered, roomy, proposed)))
        block = room.keep(room.propose(sequence.random(BLOCK)))
        roomy += len(block.points)
        for other in others:
            block = _those(block, other.meets(block))
        partnered += len(block.points)
        proposed += BLOCK
        for first in range(0, len(block.points), SLICE):
            fitting.append(_those(block, slice(first, first + SLICE)))
            enough.append(np.ones(len(fitting[-1].points), dtype=bool))
            for sensor, own, thickness in zip(sensors, rooms, indented, strict=False):
                some = _those(fitting[-1], enough[-1])
                poses = np.linalg.inv(unfold(reference, sensor, some, own.skin)) @ indenter_poses(some)
                enough[-1][enough[-1]] = (thickness.shares(poses) >= settings.least_thickness_left).all(axis=1)
            found += int(enough[-1].sum())
            if found >= count:
                break
    kept = np.concatenate(enough)
    drawn = np.arange(len(kept)) <= np.flatnonzero(kept)[count - 1]
    contacts = Contacts(**{
        field.name: np.concatenate([getattr(some, field.name) for some in fitting]) for field in fields(Contacts)
    })  # fmt: skip
    return Draw(_those(contacts, drawn & kept), _those(contacts, drawn & ~kept))


def _those(contacts: Contacts, kept: np.ndarray | slice) -> Contacts:
    """The contacts (n,) bool that are kept."""
    return Contacts(**{field.name: getattr(contacts, field.name)[kept] for field in fields(Contacts)})


def _too_few(room: "Room", others: Sequence["Room"], count: int, counts: tuple[int, int, int, int]) -> str:
    """The error line: how many contacts were found, had a partner, had room and were proposed, and what helps."""
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
    if roomy > 2 * partnered:  # most had room: the partners are missing
        names = " and ".join(other.name for other in others)
        return line + f"{roomy} contacts have room, but most have no partner on {names}; put the smallest sensor first"
    advice = "press less deep, or allow a larger max_indentation_ratio or a smaller min_edge_ratio"
    if room.lateral_reach:
        advice += f"; the path goes {room.lateral_reach * 1e3:.3g} mm sideways, shorten it"
    return line + advice


def indenter_poses(contacts: Contacts) -> np.ndarray:
    """(n, 4, 4) indenter frame -> shared frame: tip at the contact point, +y along the press direction.

    At roll 0 the frame is the shared one, turned by the least rotation that brings +y to the press direction.
    """
    poses = np.tile(np.eye(4), (len(contacts.points), 1, 1))
    cos, sin = np.cos(contacts.rolls), np.sin(contacts.rolls)
    roll = np.tile(np.eye(3), (len(cos), 1, 1))
    roll[:, 0, 0], roll[:, 0, 2], roll[:, 2, 0], roll[:, 2, 2] = cos, sin, -sin, cos
    poses[:, :3, :3] = _least_rotation(contacts.axes) @ roll
    poses[:, :3, 3] = contacts.points
    return poses


def unfold(reference: Sensor, other: Sensor, contacts: Contacts, skin: Skin | None = None) -> np.ndarray:
    """(n, 4, 4) pose of ``other``: its own frame -> shared frame, one for each contact on ``reference``.

    The rotation is a roll about x, then a pitch about z, without yaw. ``skin`` is that of ``other``, if it is known.
    Raises InputError if the other sensor has no partner for a contact.
    """
    poses = np.tile(np.eye(4), (len(contacts.points), 1, 1))
    if other is reference:
        return poses
    points, normals = partners(other, contacts, skin)
    for i, (point, normal) in enumerate(zip(points, normals, strict=True)):
        rotation = _roll_then_pitch(normal, contacts.normals[i])
        if rotation is None:
            place = _place(contacts, i)
            raise InputError(f"{other.name}: no roll and pitch bring its normal to that of contact {place}")
        poses[i, :3, :3] = rotation
        poses[i, :3, 3] = contacts.points[i] - rotation @ point
    return poses


def partners(other: Sensor, contacts: Contacts, skin: Skin | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) and outward normals (n, 3) on ``other``, in its own frame, at the contacts' (x, arc)."""
    skin = skin or Skin(other.surface)
    found = [skin.point(point[0], arc) for point, arc in zip(contacts.points, contacts.arcs, strict=True)]
    for i, partner in enumerate(found):
        if partner is None:
            raise InputError(f"{other.name}: its skin has no partner for contact {_place(contacts, i)}")
    return np.array([p for p, _ in found]).reshape(-1, 3), np.array([n for _, n in found]).reshape(-1, 3)


def _place(contacts: Contacts, i: int) -> str:
    return f"{i} (x = {contacts.points[i, 0] * 1e3:.2f} mm, lateral arc {contacts.arcs[i] * 1e3:.2f} mm)"


def _roll_then_pitch(source: np.ndarray, target: np.ndarray) -> np.ndarray | None:
    """The rotation R = R_z(pitch) R_x(roll) with R source = target, of the two the one with the smaller roll.

    The pitch leaves z alone, so the roll gives source the z of target; then both are of one length in xy, and
    the pitch turns one onto the other. None if the yz part of source is too short for that.
    """
    in_yz = np.hypot(source[1], source[2])
    if abs(target[2]) > in_yz:
        return None
    y = np.copysign(np.sqrt(in_yz**2 - target[2] ** 2), source[1])
    roll = np.arctan2(target[2], y) - np.arctan2(source[2], source[1])
    pitch = np.arctan2(target[1], target[0]) - np.arctan2(y, source[0])
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    about_z = np.array([[cp, -sp, 0.0], [sp, cp, 0.0], [0.0, 0.0, 1.0]])
    return about_z @ about_x


def _least_rotation(directions: np.ndarray) -> np.ndarray:
    """(n, 3, 3): the least rotations (Rodrigues) of +y to unit directions (n, 3); about x for -y."""
    x, y, z = directions.T
    opposite = y < -1.0 + 1e-12
    scale = 1.0 / np.where(opposite, 1.0, 1.0 + y)
    rotation = np.empty((len(directions), 3, 3))
    rotation[:, 0] = np.stack([1.0 - scale * x * x, x, -scale * x * z], axis=1)
    rotation[:, 1] = np.stack([-x, y, -z], axis=1)
    rotation[:, 2] = np.stack([-scale * x * z, z, 1.0 - scale * z * z], axis=1)
    rotation[opposite] = np.diag([1.0, -1.0, -1.0])
    return rotation


class Room:
    """The places of a sensor that have room for a contact.

    A gel on a rigid support takes presses of up to ``max_indentation_ratio`` of its local thickness. That is the
    diameter of the largest ball that touches the surface at the contact from inside and fits into the gel.

    A skin over a core takes more, because its inner side is free to move. It bends across the gap until it meets the
    core, and only the rest of the press squeezes it between indenter and core. So skin s over a gap g takes a press of
    g + ratio s. Then a ball of diameter s + g fits between the contact and what is rigid; the rule asks for the one
    that a press of depth d needs, s + g = d + (1 - ratio) s. The gap counts with a fluid, too: it flows aside.
    """

    def __init__(self, sensor: Sensor, max_depth_m: float, settings: Trajectories, lateral_reach_m: float = 0.0):
        self.name, self.settings, self.max_depth = sensor.name, settings, max_depth_m
        self.skin = Skin(sensor.surface)
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
            # What bounds the room for a press: the gel without its inner side, and the core seen from outside.
            bounds = np.concatenate([bounds[~wall], sensor.core.triangles])
            normals = np.concatenate([normals[~wall], -sensor.core.face_normals])
        self.bounds, self.bound_normals = FinePieces(bounds), normals

    def propose(self, uniform: np.ndarray) -> Contacts:
        """Contacts on the skin from points (n, 5) of the unit cube; places off the skin are left out."""
        x = self.x_range[0] + uniform[:, 0] * (self.x_range[1] - self.x_range[0])
        arcs = self.max_arc * (2.0 * uniform[:, 1] - 1.0)
        found = [self.skin.point(*place) for place in zip(x, arcs, strict=True)]
        on_skin = np.array([place is not None for place in found])
        points = np.array([place[0] for place in found if place is not None]).reshape(-1, 3)
        normals = np.array([place[1] for place in found if place is not None]).reshape(-1, 3)
        # Uniform over the cap of directions around the inward normal.
        cos = 1.0 - uniform[on_skin, 2] * (1.0 - np.cos(np.radians(self.settings.max_tilt_deg)))
        azimuth = 2.0 * np.pi * uniform[on_skin, 3]
        sin = np.sqrt(1.0 - cos**2)
        local = np.stack([sin * np.cos(azimuth), cos, sin * np.sin(azimuth)], axis=1)
        axes = np.einsum("nij,nj->ni", _least_rotation(-normals), local)
        first, last = np.radians(self.settings.roll_range_deg)
        return Contacts(points, normals, axes, first + uniform[on_skin, 4] * (last - first), arcs[on_skin])

    def keep(self, contacts: Contacts) -> Contacts:
        """Those contacts that are touchable, on material thick enough, and far enough from side walls."""
        kept = self._is_touchable(contacts.points)
        for i in np.flatnonzero(kept):
            point, normal = contacts.points[i], contacts.normals[i]
            kept[i] = self._is_thick(point, normal) and not self._is_beside_a_wall(point, normal)
        return _those(contacts, kept)

    def meets(self, contacts: Contacts) -> np.ndarray:
        """Tell, for contacts (n,) of another sensor, if each has a partner here: touchable, and far from side walls."""
        meets = np.zeros(len(contacts.points), dtype=bool)
        for i, (contact, normal) in enumerate(zip(contacts.points, contacts.normals, strict=True)):
            partner = self.skin.point(contact[0], contacts.arcs[i])
            meets[i] = (
                partner is not None
                and _roll_then_pitch(partner[1], normal) is not None
                and self._is_touchable(partner[0])
                and not self._is_beside_a_wall(*partner)
            )
        return meets

    def _is_touchable(self, points: np.ndarray) -> np.ndarray:
        return self.touchable[self.nearest.query(points)[1]]

    def _thickness_asked(self, point: np.ndarray) -> float:
        """The diameter of the ball that must fit under a contact, m."""
        if self.inner_skin is None:
            return self.solid_thickness
        skin = min(self.inner_skin(point[None])[1][0], self.solid_thickness)
        return self.max_depth + (1.0 - self.settings.max_indentation_ratio) * skin

    def _is_thick(self, point: np.ndarray, normal: np.ndarray) -> bool:
        """The ball of the asked thickness that touches the surface here from inside holds nothing that bounds it.

        The facets next to the contact do not count: they cut into the ball however thick the gel is.
        """
        radius = 0.5 * self._thickness_asked(point)
        centre = point - radius * normal
        pieces, owner = self.bounds.near(centre, radius, 0.5 * radius)
        inside = np.linalg.norm(pieces - centre, axis=2) <= radius
        next_to_it = np.linalg.norm(pieces - point, axis=2) <= 0.5 * radius
        turned_alike = self.bound_normals[owner] @ normal >= 0.0
        return not (inside & ~(next_to_it & turned_alike[:, None])).any()

    def _is_beside_a_wall(self, point: np.ndarray, normal: np.ndarray) -> bool:
        """Whether a facet that is neither turned like the contact nor away from it is nearer than the edge distance."""
        cosine = self.surface_normals @ normal
        high, low = np.cos(np.radians(WALL_TURN_DEG))
        walls = (cosine < high) & (cosine > low)
        pieces, _ = self.surface.near(point, self.edge_distance, self.wall_piece, walls)
        return bool((np.linalg.norm(pieces.mean(axis=1) - point, axis=1) <= self.edge_distance).any())
