"""Contacts that a job gives by their places on the unrolled skin of its first sensor.

A given contact obeys the rules of drawn ones (see `pairing.draw_contacts`). One that breaks a rule is an error of
input, and its line says which rule.
"""

from collections.abc import Sequence

import numpy as np

from simgen.config.trajectories import GivenContact, Trajectories
from simgen.errors import InputError
from simgen.geometry.developed_skin import Skin, skin_of
from simgen.geometry.rotations import roll_then_pitch
from simgen.sensors.least_thickness import LeastThickness
from simgen.sensors.pairing import indenter_poses, unfold
from simgen.sensors.room import Contacts, Room, contacts_at
from simgen.sensors.sensor import Sensor
from simgen.units import MM, MM_PER_M

ON_SKIN_M = 0.5e-3  # a point this near counts as on the skin: coarse triangles cut into a round one
ARC_STEP_M = 0.25e-3  # of the arcs among which the nearest is sought first
FINER, TIMES = 20, 6  # steps get finer by this factor, so many times: to 0.1 nm


def given_contacts(
    reference: Sensor,
    settings: Trajectories,
    max_depth_m: float,
    others: Sequence[Sensor] = (),
    lateral_reach_m: float = 0.0,
    indented: Sequence[LeastThickness] = (),
) -> Contacts:
    """The contacts of ``settings.contacts``. Other arguments are those of `pairing.draw_contacts`.

    Raises `InputError` for a contact that breaks a rule. Its line names the contact, the rule, and what would help.
    """
    sensors = (reference, *others)
    room, *other_rooms = (Room(sensor, max_depth_m, settings, lateral_reach_m) for sensor in sensors)
    if not settings.least_thickness_left:
        indented = ()
    found = []
    for i, given in enumerate(settings.contacts):
        contact = contact_on(room.skin, given)
        complaint = _no_skin(room, given) if not len(contact.points) else _no_room(room, contact)
        complaint = complaint or next(filter(None, (_no_partner(other, contact) for other in other_rooms)), None)
        complaint = complaint or _too_little_gel(sensors, contact, indented, settings.least_thickness_left)
        if complaint:
            place = f"x_mm {given.x_mm:.6g}, arc_mm {given.arc_mm:.6g}"
            raise InputError(f"trajectories.contacts[{i}] ({place}): {complaint}")
        found.append(contact)
    return Contacts(*(np.concatenate(each) for each in zip(*(vars(one).values() for one in found), strict=True)))


def place_on_skin(sensor: Sensor, point_m: np.ndarray) -> tuple[float, float]:
    """Place (x, arc) m on the developed skin of a sensor, of a point (3,) m on its surface in its own frame.

    The inverse of `developed_skin.Skin.points`. Raises `InputError` if the point is not on the skin.
    """
    skin, point = skin_of(sensor.surface), np.asarray(point_m, dtype=float)
    x, step = float(point[0]), ARC_STEP_M
    arcs = step * np.arange(-(steps := int(np.ceil(np.ptp(sensor.surface.bounds, axis=0)[1:].sum() / step))), steps + 1)
    for _ in range(TIMES):
        away = np.linalg.norm(skin.points(x, arcs)[0] - point, axis=1)
        if np.isnan(away).all():
            break
        nearest = int(np.nanargmin(away))
        arc, distance = float(arcs[nearest]), float(away[nearest])
        step /= FINER
        arcs = arc + step * np.arange(-FINER, FINER + 1)
    else:
        if distance <= ON_SKIN_M:
            return x, arc
    x_mm, y_mm, z_mm = MM_PER_M * point
    raise InputError(
        f"point ({x_mm:.2f}, {y_mm:.2f}, {z_mm:.2f}) mm: it is not on the skin of {sensor.name}, which unrolls from "
        "the centre line of the pad; allowed: a point of the pad or of its flanks"
    )


def contact_on(skin: Skin, given: GivenContact) -> Contacts:
    """The contact on a developed skin, without a check of the rules; no contact if the place is off the skin."""
    tilt, azimuth, roll = np.radians([[given.tilt_deg], [given.azimuth_deg], [given.roll_deg]])
    return contacts_at(skin, MM * np.array([given.x_mm]), MM * np.array([given.arc_mm]), np.cos(tilt), azimuth, roll)


def _no_skin(room: Room, given: GivenContact) -> str:
    """Error line of a place off the skin, with the arcs, or the x, that are on it."""
    low, high = MM_PER_M * np.array(room.x_range)
    arcs = np.linspace(-room.max_arc, room.max_arc, 401)
    there = np.isfinite(room.skin.points(MM * given.x_mm, arcs)[0][:, 0])
    line = f"the skin of {room.name} does not reach there; allowed: "
    if not low <= given.x_mm <= high or not there.any():
        return line + f"x_mm from {low:.2f} to {high:.2f}"
    first, last = MM_PER_M * arcs[there][[0, -1]]
    return line + f"at this x_mm, arc_mm from {first:.1f} to {last:.1f}"


def _no_room(room: Room, contact: Contacts) -> str | None:
    """The first rule that a contact breaks on the first sensor."""
    if not room.is_touchable(contact.points)[0]:
        return f"{room.name} is held there, or its support covers it; allowed: a place on its touchable surface"
    if not room.is_thick(contact.points, contact.normals)[0]:
        return (
            f"the gel of {room.name} is too thin there for a press of {_mm(room.max_depth)} mm with "
            f"max_indentation_ratio {room.settings.max_indentation_ratio:g}; press less deep, choose a place with "
            "thicker gel, or allow a larger max_indentation_ratio"
        )
    return _beside_a_wall(room, contact.points, contact.normals)


def _no_partner(room: Room, contact: Contacts) -> str | None:
    """The first rule that the partner of a contact breaks on another sensor."""
    points, normals = room.skin.points(contact.points[:, 0], contact.arcs)
    if not np.isfinite(points[0, 0]):
        return f"the skin of {room.name} has no such place; choose a place nearer to the middle of the pad"
    if not np.isfinite(roll_then_pitch(normals, contact.normals)[0, 0, 0]):
        return f"no roll and pitch bring the normal of {room.name} to that of the contact; choose a flatter place"
    if not room.is_touchable(points)[0]:
        return f"the same place of {room.name} is held, or its support covers it; choose a place nearer to the middle "\
               "of the pad"  # fmt: skip
    return _beside_a_wall(room, points, normals)


def _beside_a_wall(room: Room, points: np.ndarray, normals: np.ndarray) -> str | None:
    if not room.is_beside_a_wall(points, normals)[0]:
        return None
    ratio = f"min_edge_ratio {room.settings.min_edge_ratio:g} times the depth of {_mm(room.max_depth)} mm"
    sideways = f", and {_mm(room.lateral_reach)} mm for the path" if room.lateral_reach else ""
    return (
        f"a side wall of {room.name} is nearer than {_mm(room.edge_distance)} mm ({ratio}{sideways}); choose a place "
        "further from the edge, press less deep, or allow a smaller min_edge_ratio"
    )


def _too_little_gel(
    sensors: Sequence[Sensor], contact: Contacts, indented: Sequence[LeastThickness], allowed: float
) -> str | None:
    for sensor, thickness in zip(sensors, indented, strict=False):
        poses = np.linalg.inv(unfold(sensors[0], sensor, contact)) @ indenter_poses(contact)
        least = float(thickness.shares(poses).min())
        if least < allowed:
            left = f"leaves {least:.2g} of the thickness of the gel"
            if least < 0.0:
                left = "enters the rigid body behind the gel"
            return (
                f"an indenter {left} of {sensor.name}; least_thickness_left allows {allowed:g}; press less deep, tilt "
                "less, choose another place, or allow a smaller least_thickness_left (0: off)"
            )
    return None


def _mm(length_m: float) -> str:
    return f"{length_m * MM_PER_M:.3g}"
