"""Pairing on the bundled sensors, and on slabs and a wedge."""

import tracemalloc
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from simgen.config.indenter_path import press_path
from simgen.config.trajectories import Trajectories
from simgen.errors import InputError
from simgen.geometry.curved_tetrahedra import CORE, FREE, HELD
from simgen.geometry.developed_skin import Skin
from simgen.geometry.rigid_shape import mesh_distance, signed_distance
from simgen.sensors import pairing
from simgen.sensors.indenter import load_indenter
from simgen.sensors.indenter_pose import advanced
from simgen.sensors.least_thickness import LeastThickness
from simgen.sensors.pairing import Contacts, Room, draw_contacts, indenter_poses, partners, sample_contacts, unfold
from simgen.sensors.sensor import Sensor, load_sensor
from simgen.simulation.first_touch import first_touch

COUNT, SEED, DEPTH = 200, 1, 2.0e-3


@pytest.fixture(scope="module")
def mini():
    return load_sensor("gelsight_mini")


@pytest.fixture(scope="module")
def contacts(digit):
    return sample_contacts(digit, COUNT, SEED, DEPTH)


@pytest.fixture
def short_blocks(monkeypatch):
    """A refusal comes after 16 blocks of proposals in vain: blocks of 32."""
    monkeypatch.setattr(pairing, "BLOCK", 32)


def contacts_at(sensor, places) -> Contacts:
    """Untilted contacts at places (x, arc) in m."""
    x, arcs = np.transpose(places)
    points, normals = Skin(sensor.surface).points(x, arcs)
    return Contacts(points, normals, -normals, np.zeros(len(points)), arcs)


def slab(height: float = 4.0e-3) -> SimpleNamespace:
    """A flat gel with its back held."""
    surface = trimesh.creation.box(extents=[0.020, height, 0.020]).subdivide_to_size(2.5e-3)
    return sensor(surface, touchable=surface.vertices[:, 1] < 0.5 * height - 1e-9)


SKIN, GAP = 1.5e-3, 1.0e-3


def hollow_slab() -> SimpleNamespace:
    """A flat skin over a gap and a flat rigid core."""
    outer = trimesh.creation.box(extents=[0.024, 0.010, 0.024]).subdivide_to_size(1e-3)
    cavity = trimesh.creation.box(extents=[0.020, 0.010 - 2.0 * SKIN, 0.020]).subdivide_to_size(1e-3)
    core = trimesh.creation.box(extents=[0.019, 0.010 - 2.0 * (SKIN + GAP), 0.019]).subdivide_to_size(1e-3)
    cavity.invert()
    surface = trimesh.util.concatenate([outer, cavity])
    touchable = np.zeros(len(surface.vertices), dtype=bool)
    touchable[: len(outer.vertices)] = outer.vertices[:, 1] < 0.005 - 1e-9
    return sensor(surface, touchable, core, np.where(np.arange(len(surface.faces)) < len(outer.faces), 0, CORE))


class StandIn(SimpleNamespace):
    """Parts of a sensor, with the properties that follow from them."""

    inner_side, pieces, bounds = Sensor.inner_side, Sensor.pieces, Sensor.bounds


def sensor(surface, touchable, core=None, region=None) -> StandIn:
    """A stand-in with the parts of a sensor that pairing reads."""
    on_surface = np.arange(len(surface.vertices))
    output = SimpleNamespace(vertices=surface.vertices, surface_vertices=on_surface, touchable=touchable)
    own = {"name": "slab", "surface": surface, "surface_region": region, "core": core, "support": None}
    return StandIn(**own, output_mesh=output)


def test_contact_points_coincide_and_normals_align(digit, biotac, contacts):
    poses = unfold(digit, biotac, contacts)
    points, normals = partners(biotac, contacts)
    rotation, shift = poses[:, :3, :3], poses[:, :3, 3]
    # 1e-6 of the sensors' size (0.01 m), and of a unit vector.
    np.testing.assert_allclose(np.einsum("nij,nj->ni", rotation, points) + shift, contacts.points, atol=1e-8)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", rotation, normals), contacts.normals, atol=1e-6)


def test_partners_lie_on_the_surface(biotac, contacts):
    points, _ = partners(biotac, contacts)
    assert np.abs(mesh_distance(biotac.surface, points * 1e3)).max() < 1e-5  # mm, the distance's single precision


def test_partners_lie_on_touchable_skin(biotac, contacts):
    """Nearest surface vertices are touchable, so partners are not under the nail plate or the rear plate."""
    on_surface = np.unique(biotac.output_mesh.surface_triangles)
    nearest = cKDTree(biotac.output_mesh.vertices[on_surface]).query(partners(biotac, contacts)[0])[1]
    assert not biotac.output_mesh.touchable[on_surface].all()
    assert biotac.output_mesh.touchable[on_surface[nearest]].all()


def test_poses_are_proper_roll_and_pitch(digit, biotac, contacts):
    for poses in (unfold(digit, biotac, contacts), indenter_poses(contacts)):
        rotation = poses[:, :3, :3]
        identity = np.tile(np.eye(3), (COUNT, 1, 1))
        np.testing.assert_allclose(rotation @ rotation.transpose(0, 2, 1), identity, atol=1e-12)
        np.testing.assert_allclose(np.linalg.det(rotation), 1.0, atol=1e-12)
        np.testing.assert_array_equal(poses[:, 3], np.tile([0.0, 0.0, 0.0, 1.0], (COUNT, 1)))
    # R_z(pitch) R_x(roll) leaves the image of x in the xy plane.
    np.testing.assert_allclose(unfold(digit, biotac, contacts)[:, 2, 0], 0.0, atol=1e-12)


def test_distances_on_the_digit_are_arc_lengths_on_the_biotac(digit, biotac):
    """Straight developed paths on the BioTac's cylinder have the same length on both surfaces, to 1 %.

    The sections of both sensors hardly change with x there, so both skins unroll without stretch.
    """
    ends = np.random.default_rng(0).uniform([-10e-3, -5e-3], [-4e-3, 5e-3], (30, 2, 2))
    lengths = []
    for sensor in (digit, biotac):
        paths = np.array([np.linspace(start, end, 41) for start, end in ends])
        points, _ = Skin(sensor.surface).points(paths[..., 0], paths[..., 1])
        lengths.append(np.linalg.norm(np.diff(points, axis=1), axis=2).sum(axis=1))
    np.testing.assert_allclose(lengths[0], lengths[1], rtol=0.01)


def test_identity_at_the_centre_line(digit, biotac):
    """No roll and no lateral shift, except for the meshes' asymmetry about z = 0."""
    poses = unfold(digit, biotac, contacts_at(digit, [(x, 0.0) for x in np.linspace(-15e-3, 1e-3, 17)]))
    roll = np.degrees(np.arctan2(poses[:, 2, 1], poses[:, 2, 2]))
    assert np.abs(roll).max() < 0.2
    assert np.abs(poses[:, 2, 3]).max() < 0.03e-3


def test_the_reference_itself_does_not_move(digit, contacts):
    np.testing.assert_array_equal(unfold(digit, digit, contacts), np.tile(np.eye(4), (COUNT, 1, 1)))
    twin = SimpleNamespace(name="twin", surface=digit.surface)
    np.testing.assert_allclose(unfold(digit, twin, contacts), np.tile(np.eye(4), (COUNT, 1, 1)), atol=1e-12)


def test_a_normal_too_far_from_the_plane_across_the_finger_is_refused(digit):
    """No roll and pitch of the DIGIT give the normal of the second of two contacts on the flat pad."""
    flat = contacts_at(digit, [(-5e-3, 0.0), (-6e-3, 1e-3)])
    leaning = np.array([[1.0, 0.0, 0.0], [0.8, 0.0, 0.6]])
    roof = SimpleNamespace(name="roof", surface=trimesh.creation.box(extents=[0.05, 0.01, 0.02]))
    roof.surface.apply_transform(trimesh.transformations.rotation_matrix(np.radians(60.0), [0.0, 0.0, 1.0]))
    contacts = Contacts(flat.points, leaning, -leaning, flat.rolls, flat.arcs)
    with pytest.raises(InputError, match=r"roof: no roll and pitch bring its normal to .* contact 1 \(x = -6.00 mm"):
        unfold(digit, roof, contacts)


def test_room_for_many_contacts_is_that_of_each(digit, biotac):
    """Room and partners of a contact do not depend on the contacts that are looked at together with it."""
    for first, second in ((digit, biotac), (biotac, digit)):
        room, other = (Room(each, 1e-3, Trajectories(count=5)) for each in (first, second))
        proposed = room.propose(np.random.default_rng(SEED).random((150, 5)))
        kept = np.isin(proposed.arcs, room.keep(proposed).arcs)
        meets = other.meets(proposed)
        assert 10 < kept.sum() < len(kept) - 10 and 10 < meets.sum() < len(meets)
        for i, (is_kept, has_partner) in enumerate(zip(kept, meets, strict=True)):
            one = Contacts(*(getattr(proposed, f)[i : i + 1] for f in ("points", "normals", "axes", "rolls", "arcs")))
            assert (len(room.keep(one).points), other.meets(one)[0]) == (is_kept, has_partner)


def test_indenters_stand_on_their_contacts(contacts):
    poses = indenter_poses(contacts)
    np.testing.assert_array_equal(poses[:, :3, 3], contacts.points)
    np.testing.assert_allclose(poses[:, :3, 1], contacts.axes, atol=1e-12)


def test_roll_turns_the_indenter_about_its_axis(contacts):
    """Two poses that differ by a roll of 30 degrees differ by that turn about +y."""
    turned = Contacts(contacts.points, contacts.normals, contacts.axes, contacts.rolls + np.pi / 6, contacts.arcs)
    a, b = indenter_poses(contacts)[:, :3, :3], indenter_poses(turned)[:, :3, :3]
    expected = trimesh.transformations.rotation_matrix(np.pi / 6, [0.0, 1.0, 0.0])[:3, :3]
    np.testing.assert_allclose(a.transpose(0, 2, 1) @ b, np.tile(expected, (COUNT, 1, 1)), atol=1e-12)


def test_same_seed_same_contacts_whatever_the_count(digit, contacts):
    fewer = sample_contacts(digit, 17, SEED, DEPTH)
    for name in ("points", "normals", "axes", "rolls", "arcs"):
        np.testing.assert_array_equal(getattr(fewer, name), getattr(contacts, name)[:17])
    other = sample_contacts(digit, 17, SEED + 1, DEPTH)
    assert np.abs(other.points - fewer.points).max() > 1e-3


def test_contacts_do_not_depend_on_how_many_are_proposed_at_a_time(digit, monkeypatch):
    at_once = []
    blocks = pairing._blocks

    def watched(*arguments):
        at_once.append(blocks(*arguments))
        return at_once[-1]

    monkeypatch.setattr(pairing, "_blocks", watched)
    many = sample_contacts(digit, 300, SEED, DEPTH)
    assert max(at_once) > 1
    monkeypatch.setattr(pairing, "_blocks", lambda *_: 1)
    one_by_one = sample_contacts(digit, 300, SEED, DEPTH)
    for field in ("points", "normals", "axes", "rolls", "arcs"):
        np.testing.assert_array_equal(getattr(many, field), getattr(one_by_one, field))


def test_tilt_and_roll_stay_in_their_ranges(digit):
    settings = Trajectories(count=5, max_tilt_deg=20.0, roll_range_deg=(10.0, 40.0))
    contacts = sample_contacts(digit, COUNT, SEED, DEPTH, settings)
    tilt = np.degrees(np.arccos(-np.einsum("ni,ni->n", contacts.axes, contacts.normals)))
    assert 15.0 < tilt.max() <= 20.0 + 1e-6
    assert 10.0 <= np.degrees(contacts.rolls).min() < 15.0
    assert 35.0 < np.degrees(contacts.rolls).max() <= 40.0
    upright = sample_contacts(digit, 5, SEED, DEPTH, Trajectories(count=5, max_tilt_deg=0.0))
    np.testing.assert_allclose(upright.axes, -upright.normals, atol=1e-12)


def test_contacts_keep_to_thick_gel(digit, contacts):
    """The thickness under every contact is at least depth / ratio = 3.33 mm, less 0.1 mm between facets."""
    back = digit.surface.bounds[1, 1]
    thickness = (back - contacts.points[:, 1]) / -contacts.normals[:, 1]
    assert thickness.min() > 3.33e-3 - 1e-4
    assert len(np.unique(np.round(contacts.points, 9), axis=0)) == COUNT


def test_contacts_keep_their_distance_from_walls():
    """On a slab of half width 10 mm the margin is 1.5 x 2 mm, and contacts fill the rest."""
    contacts = sample_contacts(slab(), COUNT, SEED, DEPTH)
    margin = 10e-3 - np.abs(contacts.points[:, [0, 2]])
    assert margin.min() >= 3e-3 - 0.05e-3  # the wall is sampled at the centres of faces
    assert margin.min() < 3.5e-3
    np.testing.assert_allclose(contacts.points[:, 1], -2e-3, atol=1e-12)


def test_too_thin_a_sensor_is_refused(short_blocks):
    with pytest.raises(InputError, match=r"slab: 0 of 5 contacts fit .* max_indentation_ratio"):
        sample_contacts(slab(height=3e-3), 5, SEED, DEPTH)


def test_a_sheet_far_thinner_than_the_press_is_refused(short_blocks):
    with pytest.raises(InputError, match="slab: 0 of 5 contacts fit"):
        sample_contacts(slab(height=0.15e-3), 5, SEED, DEPTH)


def test_a_skin_over_a_core_takes_the_gap_and_its_own_share(short_blocks):
    """0.6 of the skin of 1.5 mm and the gap of 1 mm allow 1.9 mm, to the 0.06 mm between samples."""
    deepest = GAP + 0.6 * SKIN
    assert len(sample_contacts(hollow_slab(), 5, SEED, deepest - 1e-6).points) == 5
    with pytest.raises(InputError, match="slab: 0 of 5 contacts fit"):
        sample_contacts(hollow_slab(), 5, SEED, deepest + 0.06e-3)


def test_contacts_on_the_biotac_reach_two_millimetres(biotac):
    """Compare with a ball's signed distance from the core, for the nominal skin of 1.57 mm."""
    for depth in (0.3e-3, 1.0e-3, 2.0e-3):
        contacts = sample_contacts(biotac, 40, SEED, depth)
        radius = 0.5 * min(depth / 0.6, depth + 0.4 * 1.57e-3)
        centres = contacts.points - radius * contacts.normals
        assert mesh_distance(biotac.core, centres * 1e3).min() > (radius - 0.05e-3) * 1e3  # between the core's vertices


def peak_of_sampling(reference, depth: float) -> int:
    """Peak of memory, bytes."""
    tracemalloc.start()
    sample_contacts(reference, 5, SEED, depth)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def test_memory_does_not_depend_on_the_depth(digit):
    deep = peak_of_sampling(digit, DEPTH)
    for depth in (0.2e-3, 0.01e-3):
        assert peak_of_sampling(digit, depth) < 1.5 * deep


def test_contacts_without_a_partner_are_drawn_again(digit, biotac):
    """The BioTac's skin reaches round the finger, but the DIGIT's does not; the first n do not depend on the count."""
    contacts = sample_contacts(biotac, 40, SEED, 1.0e-3, others=[digit])
    alone = sample_contacts(biotac, 40, SEED, 1.0e-3)
    assert np.abs(alone.arcs).max() > 12e-3 > np.abs(contacts.arcs).max()
    on_surface = np.unique(digit.output_mesh.surface_triangles)
    nearest = cKDTree(digit.output_mesh.vertices[on_surface]).query(partners(digit, contacts)[0])[1]
    assert digit.output_mesh.touchable[on_surface[nearest]].all()
    poses = unfold(biotac, digit, contacts)
    _, normals = partners(digit, contacts)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", poses[:, :3, :3], normals), contacts.normals, atol=1e-6)
    fewer = sample_contacts(biotac, 7, SEED, 1.0e-3, others=[digit])
    np.testing.assert_array_equal(fewer.points, contacts.points[:7])


def test_partners_on_the_biotac_leave_the_contacts_on_the_digit_as_they_are(digit, biotac, contacts):
    paired = sample_contacts(digit, COUNT, SEED, DEPTH, others=[biotac])
    np.testing.assert_array_equal(paired.points, contacts.points)


def test_a_contact_exists_on_all_three_sensors(digit, biotac, mini):
    """Whichever sensor comes first, its contacts meet touchable skin of both others, with the same normal."""
    for reference, *others in ((digit, biotac, mini), (mini, digit, biotac), (biotac, mini, digit)):
        drawn = sample_contacts(reference, 20, SEED, 1e-3, others=others)
        for other in others:
            points, normals = partners(other, drawn)
            vertices = other.output_mesh.surface_vertices
            nearest = vertices[cKDTree(other.output_mesh.vertices[vertices]).query(points)[1]]
            assert other.output_mesh.touchable[nearest].all()
            pose = unfold(reference, other, drawn)
            np.testing.assert_allclose(np.einsum("nij,nj->ni", pose[:, :3, :3], normals), drawn.normals, atol=1e-6)
            reached = np.einsum("nij,nj->ni", pose[:, :3, :3], points) + pose[:, :3, 3]
            np.testing.assert_allclose(reached, drawn.points, atol=1e-8)


def test_the_middles_of_the_digit_and_the_gelsight_mini_meet(digit, mini):
    """Both gels lie in one frame: their apexes are the same point, so the pose is the identity there, to 0.05 mm."""
    middle = contacts_at(digit, [(-7.56e-3, 0.0)])
    pose = unfold(digit, mini, middle)[0]
    np.testing.assert_allclose(pose[:3, :3], np.eye(3), atol=0.02)
    np.testing.assert_allclose(partners(mini, middle)[0], middle.points, atol=0.05e-3)


def test_a_sensor_on_which_most_contacts_have_no_partner_is_named(short_blocks):
    tiny = slab()
    tiny.name, tiny.surface = "tiny", trimesh.creation.box(extents=[1e-4, 4e-3, 0.02])
    with pytest.raises(InputError, match=r"slab: \d of 5 contacts fit .* have no partner on tiny; put the smallest"):
        sample_contacts(slab(), 5, SEED, DEPTH, others=[tiny])


def test_a_contact_without_partner_is_refused(digit, contacts):
    """The error names the contact that a sensor is too short to meet."""
    short = SimpleNamespace(name="short", surface=trimesh.creation.box(extents=[1e-3, 0.01, 0.02]))
    with pytest.raises(InputError, match="short: its skin has no partner for contact"):
        unfold(digit, short, contacts)


def test_room_for_a_long_leg_is_found_with_few_pieces():
    """For 0.01 mm deep and 3 mm sideways, pieces are as large as the edge distance, not as the depth."""
    digit = load_sensor("digit", "coarse")
    room = Room(digit, 1e-5, Trajectories(count=5), lateral_reach_m=3e-3)
    assert room.edge_distance > 3e-3 and room.wall_piece > 0.2 * room.edge_distance
    contacts = sample_contacts(digit, 4, 0, 1e-5, lateral_reach_m=3e-3)
    assert len(contacts.points) == 4


def wedge() -> SimpleNamespace:
    """A gel that gets thinner towards +x, 4.6 to 3.4 mm; its slanted back is held."""
    surface = trimesh.creation.box(extents=[0.030, 4e-3, 0.030]).subdivide_to_size(2.5e-3)
    back = surface.vertices[:, 1] > 2e-3 - 1e-9
    surface.vertices[back, 1] -= 0.04 * surface.vertices[back, 0]
    held = back[surface.faces].all(axis=1)
    return sensor(surface, touchable=~back, region=np.where(held, HELD, FREE))


CUBES = [load_indenter(name).shape() for name in ("sphere_3.5mm", "cube_14mm")]
PRESS = press_path([1e-3, DEPTH])


def draw(count: int, share: float, **changes):
    settings = Trajectories(count=5, least_thickness_left=share, **changes)
    gel = wedge()
    return draw_contacts(gel, count, SEED, DEPTH, settings, indented=[LeastThickness(gel, CUBES, PRESS)])


def test_contacts_where_an_indenter_leaves_too_little_are_drawn_again():
    drawn, measure = draw(40, 0.45), LeastThickness(wedge(), CUBES, PRESS)
    assert len(drawn.kept.points) == 40 and len(drawn.refused.points) > 10
    shares = measure.shares(indenter_poses(drawn.kept))
    assert (shares >= 0.45).all()
    refused = measure.shares(indenter_poses(drawn.refused))
    assert (refused.min(axis=1) < 0.45).all() and (refused[:, 0] >= 0.45).any()  # one of two indenters is enough
    assert drawn.kept.points[:, 0].mean() < drawn.refused.points[:, 0].mean() - 2e-3  # the thin side is at +x


def test_kept_and_refused_contacts_are_those_without_the_rule():
    drawn, all_of_them = draw(40, 0.45), draw(80, 0.0)
    assert not len(all_of_them.refused.points)
    both = np.concatenate([drawn.kept.points, drawn.refused.points])
    first = all_of_them.kept.points[: len(both)]
    np.testing.assert_array_equal(both[np.lexsort(both.T)], first[np.lexsort(first.T)])
    np.testing.assert_array_equal(sample_contacts(wedge(), 80, SEED, DEPTH).points, all_of_them.kept.points)


def test_the_first_contacts_and_refusals_are_those_of_more():
    more, fewer = draw(40, 0.45), draw(11, 0.45)
    for part in ("kept", "refused"):
        few, many = getattr(fewer, part), getattr(more, part)
        for name in ("points", "normals", "axes", "rolls", "arcs"):
            np.testing.assert_array_equal(getattr(few, name), getattr(many, name)[: len(few.points)])


def test_too_few_contacts_that_leave_enough_name_the_key_and_what_helps(short_blocks):
    expected = r"slab: 0 of 5 contacts fit .*; \d+ contacts fit other.*, .* least_thickness_left 0\.7 .*too_thin: stop"
    with pytest.raises(InputError, match=expected) as caught:
        draw(5, 0.7)
    assert "\n" not in str(caught.value)


def test_kept_contacts_press_no_indenter_into_the_core(digit, biotac):
    """Without the rule the ring ends in the core at one of the first 23 contacts.

    First touch is found on the simulation mesh, then signed distances of the core's vertices.
    """
    ring = [load_indenter("ring_7mm").shape()]
    measures = [LeastThickness(each, ring, PRESS) for each in (digit, biotac)]

    def least_gaps(contacts):
        poses = np.linalg.inv(unfold(digit, biotac, contacts)) @ indenter_poses(contacts)
        in_mm, mesh, core = poses.copy(), biotac.simulation_mesh, biotac.core.vertices
        in_mm[:, :3, 3] *= 1e3
        travel, _, _ = first_touch(mesh.nodes * 1e3, mesh.touchable, ring * len(poses), in_mm)
        ends = advanced(poses, 1e-3 * travel + DEPTH)
        return np.array([signed_distance(ring[0], 1e3 * (core - end[:3, 3]) @ end[:3, :3])[0].min() for end in ends])

    drawn = draw_contacts(digit, 21, SEED, DEPTH, others=[biotac], indented=measures)
    assert least_gaps(drawn.kept).min() > 0.15 * 1.4  # mm: the share of the skin's least thickness
    assert len(drawn.refused.points) and least_gaps(drawn.refused).min() < 0.0
