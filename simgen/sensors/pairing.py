"""Pairing: contacts that are sampled once in the shared frame, and the poses that bring every sensor to them.

Contacts come from a low-discrepancy sequence over the developed (unrolled) skin of the reference sensor, see
`developed_skin`. The transform of `unfold` rolls, pitches and shifts another sensor, so that the point at the same
place of its own developed skin meets the contact with the same normal.

Shared frame, metres: x along the finger, pad side -y, z lateral.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields

import numpy as np

from simgen.config.trajectories import Trajectories
from simgen.errors import InputError
from simgen.geometry.developed_skin import skin_of
from simgen.geometry.rotations import least_rotations, roll_then_pitch
from simgen.sensors.least_thickness import LeastThickness
from simgen.sensors.room import Contacts, Room, subset
from simgen.sensors.sensor import Sensor

BLOCK = 256  # contacts drawn at a time: a power of two, as Sobol sequences need
MOST_BLOCKS = 8  # proposed at a time, while the gel under those before is measured
FIRST_SHARE = 1 / 6  # of proposals that are kept, a guess for the first ones; 0.18 in jobs/paired.yaml
SLICE = 32  # least number of contacts at a time for which the gel under the indenters is measured
MOST_PROPOSED = 200  # proposals per contact found, after 16 blocks; beyond that there is too little room


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
    settings = settings or Trajectories(count=count)
    sensors = (reference, *others)
    with ThreadPoolExecutor() as threads:
        rooms = threads.map(lambda sensor: Room(sensor, max_depth_m, settings, lateral_reach_m), sensors)
        from scipy.stats import qmc  # takes a third of a second, so processes that only press do not import it
    room, *others = rooms
    if not settings.least_thickness_left:
        indented = ()
    sequence = qmc.Sobol(5, scramble=True, rng=seed)
    fitting, enough = [], []  # proposals with room and partners, and masks: enough gel is left
    found = roomy = partnered = proposed = 0
    share = FIRST_SHARE  # of the proposals that is kept

    def propose(blocks: int) -> tuple[int, int, Contacts]:
        """Make proposals: the number of blocks, the number of contacts with room, and those that also have partners."""
        some = room.keep(room.propose(np.concatenate([sequence.random(BLOCK) for _ in range(blocks)])))
        with_room = len(some.points)
        for other in others:
            some = subset(some, other.meets(some))
        return blocks, with_room, some

    with ThreadPoolExecutor(1) as ahead:
        coming = ahead.submit(propose, _blocks(count, share))
        while found < count:
            if proposed >= 16 * BLOCK and proposed > MOST_PROPOSED * found:
                raise InputError(_too_few(room, others, count, (found, partnered, roomy, proposed)))
            blocks, with_room, some = coming.result()
            roomy, partnered, proposed = roomy + with_room, partnered + len(some.points), proposed + blocks * BLOCK
            # While the gel under these is measured, the thread makes the next ones, if they will probably be needed.
            missing = count - found - share * blocks * BLOCK
            coming = ahead.submit(propose, _blocks(missing, share)) if missing > 0.0 else None
            presses = [
                np.linalg.inv(unfold(reference, sensor, some)) @ indenter_poses(some)
                for sensor, _ in zip(sensors, indented, strict=False)
            ]
            first = 0
            while first < len(some.points) and found < count:
                tested = sum(map(len, enough))
                wanted = (count - found) * tested / found if found else count
                part = slice(first, first + max(SLICE, int(np.ceil(wanted))))
                fitting.append(subset(some, part))
                enough.append(np.ones(len(fitting[-1].points), dtype=bool))
                for thickness, poses in zip(indented, presses, strict=False):
                    shares = thickness.shares(poses[part][enough[-1]])
                    enough[-1][enough[-1]] = (shares >= settings.least_thickness_left).all(axis=1)
                found += int(enough[-1].sum())
                first = part.stop
            if found:
                share = found / proposed
            if coming is None and found < count:
                coming = ahead.submit(propose, _blocks(count - found, share))
    kept = np.concatenate(enough)
    drawn = np.arange(len(kept)) <= np.flatnonzero(kept)[count - 1]
    contacts = Contacts(**{
        field.name: np.concatenate([getattr(some, field.name) for some in fitting]) for field in fields(Contacts)
    })  # fmt: skip
    return Draw(subset(contacts, drawn & kept), subset(contacts, drawn & ~kept))


def _blocks(missing: float, share: float) -> int:
    """Number of blocks to propose next for so many missing contacts, if a share of the proposals is kept."""
    return max(1, min(int(np.ceil(missing / (share * BLOCK))), MOST_BLOCKS))


def _too_few(room: Room, others: Sequence[Room], count: int, counts: tuple[int, int, int, int]) -> str:
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
