"""Contacts at given places: they equal drawn ones, obey the same rules, and come back from points of the skin."""

from types import SimpleNamespace

import numpy as np
import pytest

from simgen.config.indenter_path import press_path
from simgen.config.trajectories import GivenContact, Trajectories
from simgen.errors import InputError
from simgen.geometry.developed_skin import skin_of
from simgen.geometry.rotations import least_rotations
from simgen.sensors.given_contacts import contact_on, given_contacts, place_on_skin
from simgen.sensors.indenter import load_indenter
from simgen.sensors.least_thickness import LeastThickness
from simgen.sensors.pairing import sample_contacts

DEPTH = 1e-3
FIELDS = ("points", "normals", "axes", "rolls", "arcs")


def settings(*places, **changes) -> Trajectories:
    contacts = tuple(place if isinstance(place, GivenContact) else GivenContact(**place) for place in places)
    return Trajectories(count=len(contacts), contacts=contacts, **changes)


def at(x_mm, arc_mm, **angles) -> GivenContact:
    return GivenContact(x_mm=float(x_mm), arc_mm=float(arc_mm), **angles)


def drawn_places(contacts) -> list[GivenContact]:
    """Places and angles of drawn contacts."""
    local = np.einsum("nji,nj->ni", least_rotations(-contacts.normals), contacts.axes)
    tilt = np.degrees(np.arctan2(np.hypot(local[:, 0], local[:, 2]), local[:, 1]))
    azimuth, roll = np.degrees(np.arctan2(local[:, 2], local[:, 0])), np.degrees(contacts.rolls)
    rows = np.column_stack([1e3 * contacts.points[:, 0], 1e3 * contacts.arcs, tilt, azimuth, roll])
    return [GivenContact(**dict(zip(GivenContact.model_fields, row, strict=True))) for row in rows.tolist()]


def test_drawn_places_give_the_drawn_contacts(digit, biotac):
    """Contacts on both sensors, with tilts to 20 degrees; a nanometre is 1e-9."""
    for first, second in ((digit, biotac), (biotac, digit)):
        trajectories = Trajectories(count=40, max_tilt_deg=20.0)
        drawn = sample_contacts(first, 40, 3, DEPTH, trajectories, others=[second])
        given = given_contacts(first, settings(*drawn_places(drawn)), DEPTH, [second])
        for field in FIELDS:
            np.testing.assert_allclose(getattr(given, field), getattr(drawn, field), rtol=0.0, atol=1e-12)


def test_angles_turn_the_press_axis_as_they_say(digit):
    """On the flat middle of the DIGIT's pad, azimuth 0 tilts towards +x, and 90 towards +z."""
    upright = given_contacts(digit, settings(at(-7.6, 0.0)), DEPTH)
    np.testing.assert_allclose(upright.axes, -upright.normals, atol=1e-15)
    for azimuth, axis in ((0.0, 0), (90.0, 2)):
        tilted = given_contacts(digit, settings(at(-7.6, 0.0, tilt_deg=10.0, azimuth_deg=azimuth)), DEPTH).axes[0]
        assert tilted @ upright.axes[0] == pytest.approx(np.cos(np.radians(10.0)))
        assert tilted[axis] == pytest.approx(np.sin(np.radians(10.0)), abs=0.02)


@pytest.mark.parametrize("model", ["digit", "biotac"])
def test_points_of_the_skin_give_their_places(model, request):
    sensor = request.getfixturevalue(model)
    drawn = sample_contacts(sensor, 60, 1, DEPTH)
    for point, arc in zip(drawn.points, drawn.arcs, strict=True):
        np.testing.assert_allclose(place_on_skin(sensor, point), (point[0], arc), rtol=0.0, atol=1e-10)


def test_a_point_beside_the_skin_gives_the_nearest_place(digit):
    """Pages draw coarser triangles, which cut into the round pad."""
    [point], [normal] = skin_of(digit.surface).points(np.array([-6e-3]), np.array([4e-3]))
    x, arc = place_on_skin(digit, point - 0.05e-3 * normal)
    assert arc == pytest.approx(4e-3, abs=0.01e-3)
    assert x == pytest.approx(-6e-3, abs=0.01e-3)


@pytest.mark.parametrize("point_mm", [(-6.0, 5.0, 0.0), (40.0, -8.0, 0.0), (-6.0, -7.0, 0.0)],
                         ids=["beyond the back", "beyond the end", "inside"])  # fmt: skip
def test_a_point_off_the_skin_is_refused(digit, point_mm):
    with pytest.raises(InputError, match=r"point \(.*\) mm: it is not on the skin of digit, .*; allowed: a point of"):
        place_on_skin(digit, 1e-3 * np.array(point_mm))


def test_a_place_off_the_skin_gives_no_contact(digit):
    assert len(contact_on(skin_of(digit.surface), at(-6.0, 30.0)).points) == 0


@pytest.mark.parametrize(
    ("place", "depth", "line"),
    [
        (at(50.0, 0.0), DEPTH, r"the skin of digit does not reach there; allowed: x_mm from -20\.06 to 4\.94"),
        (at(-6.0, 30.0), DEPTH, r"the skin of digit does not reach .*: at this x_mm, arc_mm from -13\.0 to 13\.0"),
        (at(-6.0, 12.9), 0.1e-3, r"digit is held there, or its support covers it; allowed: .* touchable surface"),
        (at(-6.0, 8.0), 2.3e-3, r"the gel of digit is too thin there for a press of 2\.3 mm with max_"),
        (at(4.0, 0.0), DEPTH, r"a side wall of digit is nearer than 1\.5 mm \(min_edge_ratio 1\.5 times the depth of 1 "
                              r"mm\); choose a place further from the edge, press less deep, or allow a smaller"),
    ],
    ids=["beyond the end", "beyond the side", "held", "thin", "wall"],
)  # fmt: skip
def test_a_contact_that_breaks_a_rule_is_refused_with_the_rule(digit, place, depth, line):
    with pytest.raises(InputError, match=rf"^trajectories\.contacts\[1\] \(x_mm .*, arc_mm .*\): {line}"):
        given_contacts(digit, settings(at(-6.0, 0.0), place), depth)


def test_sideways_paths_need_more_distance_from_walls(digit):
    place = at(2.5, 0.0)
    assert len(given_contacts(digit, settings(place), DEPTH).points) == 1
    with pytest.raises(InputError, match=r"nearer than 3\.5 mm \(min_edge_ratio 1\.5 .*, and 2 mm for the path\)"):
        given_contacts(digit, settings(place), DEPTH, lateral_reach_m=2e-3)


def test_a_contact_without_a_partner_names_the_other_sensor(digit, biotac):
    with pytest.raises(InputError, match=r"contacts\[0\] \(x_mm -6, arc_mm 14\): the same place of digit is held, or"):
        given_contacts(biotac, settings(at(-6.0, 14.0)), 0.3e-3, [digit])
    surface = digit.surface.copy().apply_scale([1.0, 1.0, 0.4])
    slim = SimpleNamespace(**vars(digit) | {"name": "slim", "surface": surface})
    with pytest.raises(InputError, match=r"contacts\[0\] \(x_mm -6, arc_mm 11\): the skin of slim has no such place"):
        given_contacts(biotac, settings(at(-6.0, 11.0)), 0.3e-3, [slim])
    with pytest.raises(InputError, match=r"a side wall of digit is nearer than 1\.5 mm"):
        given_contacts(biotac, settings(at(4.2, 0.0)), DEPTH, [digit])


def test_too_little_gel_under_an_indenter_is_refused(digit):
    depth = 1.6e-3
    indented = [LeastThickness(digit, [load_indenter("sphere_14mm").shape()], press_path([depth]))]
    place = at(-17.0, 0.0, tilt_deg=25.0, azimuth_deg=180.0)
    loose = settings(place, min_edge_ratio=0.0, max_indentation_ratio=0.9, least_thickness_left=0.0)
    assert len(given_contacts(digit, loose, depth, indented=indented).points) == 1
    strict = settings(place, min_edge_ratio=0.0, max_indentation_ratio=0.9, least_thickness_left=0.7)
    with pytest.raises(InputError, match=r"an indenter leaves 0\.\d+ of the thickness of the gel of digit; .* 0\.7;"):
        given_contacts(digit, strict, depth, indented=indented)
