"""Contacts from places and angles. Rules of room are tested with the contacts that they leave, in test_pairing."""

import numpy as np

from simgen.config.trajectories import Trajectories
from simgen.geometry.developed_skin import skin_of
from simgen.sensors.room import Room, contacts_at, subset


def test_contacts_stand_at_their_places_and_others_are_left_out(digit):
    """The second of three places is beyond the end of the skin."""
    x, arcs = 1e-3 * np.array([[-6.0, 60.0, -8.0], [2.0, 2.0, -3.0]])
    tilts, azimuths, rolls = np.radians([[10.0, 0.0, 0.0], [30.0, 0.0, 0.0], [15.0, 0.0, -20.0]])
    contacts = contacts_at(skin_of(digit.surface), x, arcs, np.cos(tilts), azimuths, rolls)
    points, normals = skin_of(digit.surface).points(x[[0, 2]], arcs[[0, 2]])
    np.testing.assert_array_equal(contacts.points, points)
    np.testing.assert_array_equal(contacts.normals, normals)
    np.testing.assert_array_equal(contacts.arcs, arcs[[0, 2]])
    np.testing.assert_array_equal(contacts.rolls, rolls[[0, 2]])
    between = np.degrees(np.arccos(-np.vecdot(contacts.axes, contacts.normals)))
    np.testing.assert_allclose(between, [10.0, 0.0], atol=1e-5)
    np.testing.assert_array_equal(subset(contacts, np.array([False, True])).points, points[1:])
    np.testing.assert_array_equal(subset(contacts, slice(1)).axes, contacts.axes[:1])


def test_threads_keep_the_same_contacts(digit, biotac, monkeypatch):
    """Each thread tests a part of the contacts: several threads find what one finds, in the same order."""
    uniform = np.random.default_rng(3).random((600, 5))
    rooms = [Room(sensor, 2e-3, Trajectories(count=1)) for sensor in (digit, biotac)]
    found = []
    for cores in (1, 16):
        monkeypatch.setattr("os.cpu_count", lambda cores=cores: cores)
        kept = rooms[0].keep(rooms[0].propose(uniform))
        found.append((kept.points, kept.rolls, rooms[1].meets(kept)))
    assert 64 < len(found[0][0]) < 600  # more than one thread had work
    for one, several in zip(*found, strict=True):
        np.testing.assert_array_equal(one, several)
