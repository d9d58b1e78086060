import numpy as np
import pytest
import trimesh
import warp as wp

from simgen.fem.batch_arrays import ActiveEnvironments
from simgen.fem.contact.contact import Contact
from simgen.fem.contact.traction import Surface, face_positions, gap_lower_bound
from simgen.fem.elements.element import P2P1
from simgen.geometry.rigid_shape import rigid_shape, sampled_shape, signed_distance
from simgen.geometry.signed_distance import Kind
from simgen.simulation.first_touch import dense_shapes
from tests.fem.box import box, top

CUBE = rigid_shape(Kind.CUBE, 20.0, 1.0)  # its flat face covers the whole box
SPHERE = rigid_shape(Kind.SPHERE, 3.5)
K = 60.0  # of a face of the box
NEAR = np.ones(1)  # mm: all faces of the box are near
STIFFNESS = (2.0 * K, 2.0 * 15.0)  # its faces have edges of 2 mm


def contact(friction, shape, n_env=1):
    nodes, _, _, faces = box()
    active = ActiveEnvironments(n_env, "cpu")
    term = Contact(P2P1, nodes, top(nodes, faces), STIFFNESS, friction, "cpu", active)
    term.set_shapes([shape] * n_env)
    return nodes, term


def state(x):
    return wp.array(np.ascontiguousarray(x, dtype=float).reshape(len(x), -1), dtype=wp.float64, device="cpu")


def pose(*translation):
    out = np.eye(4)[None].copy()
    out[0, :3, 3] = translation
    return out


def forces(term, x):
    r = wp.zeros(x.shape, dtype=wp.float64, device="cpu")
    term.residual(x, r)
    return r.numpy()[:, 0]


def update(term, x):
    """Move the multipliers to the tractions at x; norms of the change and of what they are then, as before it."""
    forces(term, x)
    change = np.sqrt(term.multiplier_change().numpy() / term.edge)
    term.update_multipliers()
    return change


def test_a_flat_overlap_presses_with_stiffness_times_depth_times_area():
    nodes, term = contact(0.0, CUBE)
    rest = state(np.zeros(3 * len(nodes)))
    term.set_pose(pose(0.0, 0.01, 0.0))
    force, moment, rms, deepest, _ = term.resultants(rest)
    np.testing.assert_allclose(force[0], [0.0, K * 0.01 * 36.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(moment[0], 0.0, atol=1e-12)
    assert rms[0] == pytest.approx(0.01) and deepest[0] == pytest.approx(0.01)
    nodal = forces(term, rest).reshape(-1, 3).sum(axis=0)
    np.testing.assert_allclose(nodal, -force[0], atol=1e-12)


@pytest.mark.parametrize("pressure, factor", [(0.9, 1.0), (1.1, 2.0), (3.0, 4.0), (4.0, 4.0), (99.0, 16.0)])
def test_stiffness_follows_the_pressure_in_powers_of_two(pressure, factor):
    """The pressure is counted in E, which is 1 here; the stiffness holds from the next increment on."""
    nodes, term = contact(0.0, CUBE)
    rest = state(np.zeros(3 * len(nodes)))
    term.surface.normal.fill_(pressure)
    touching, overlapping = pose(0.0, 0.0, 0.0), pose(0.0, 0.01, 0.0)
    term.begin_increment(rest, rest, touching, overlapping, NEAR)
    force = term.resultants(rest).force[0]
    np.testing.assert_allclose(force, [0.0, (pressure + factor * K * 0.01) * 36.0, 0.0], atol=1e-12)
    term.restore(ActiveEnvironments(1, "cpu"))
    force = term.resultants(rest).force[0]
    np.testing.assert_allclose(force, [0.0, (pressure + K * 0.01) * 36.0, 0.0], atol=1e-12)


def test_stiffness_grows_where_the_overlap_is_deep():
    """Faces have edges of 2 mm: 0.5 mm are a quarter, 1.67 times what a face holds with its own stiffness."""
    nodes, term = contact(0.0, CUBE)
    rest = state(np.zeros(3 * len(nodes)))
    term.surface.normal.fill_(0.1)
    deep = pose(0.0, 0.5, 0.0)
    for factor in (2.0, 4.0, 8.0, 16.0, 16.0):
        term.begin_increment(rest, rest, deep, deep, NEAR)
        assert (term.surface.stiffening.numpy() == factor).all()


def test_stiffness_goes_with_one_over_the_edge():
    nodes, _, _, faces = box()
    big = Contact(P2P1, 3.0 * nodes, top(nodes, faces), STIFFNESS, 0.0, "cpu", ActiveEnvironments(1, "cpu"))
    big.set_shapes([rigid_shape(Kind.CUBE, 60.0, 1.0)])
    big.set_pose(pose(0.0, 0.01, 0.0))
    force = big.resultants(state(np.zeros(3 * len(nodes))))[0]
    assert force[0, 1] == pytest.approx(K / 3.0 * 0.01 * 9.0 * 36.0)


def test_an_update_weighs_by_area_over_stiffness():
    """Faces of two sizes: each multiplier moves by the mean of t around its corner, with weights area times edge."""
    nodes, _, _, faces = box()
    graded = nodes * 1.0
    graded[:, 0] += 3.0 * np.maximum(nodes[:, 0] - 1.0, 0.0)  # the last of three cells is four times as long
    on_top = top(nodes, faces)
    term = Contact(P2P1, graded, on_top, STIFFNESS, 0.0, "cpu", ActiveEnvironments(1, "cpu"))
    term.set_shapes([CUBE])
    term.set_pose(pose(0.0, 0.01, 0.0))
    update(term, state(np.zeros(3 * len(nodes))))
    a, b, c = (graded[on_top[:, i]] for i in range(3))
    areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    edges = np.sqrt(2.0 * areas)
    assert edges.max() > 1.5 * edges.min()
    slots = term.surface.slots.numpy()
    above, below = np.zeros((2, term.n_slots))
    for i in range(3):
        np.add.at(above, slots[:, i], edges * areas * STIFFNESS[0] / edges * 0.01)
        np.add.at(below, slots[:, i], edges * areas)
    np.testing.assert_allclose(term.surface.normal.numpy()[:, 0], above / below, rtol=1e-12)


@pytest.mark.parametrize(("friction", "sideways"), [(0.0, 0.0), (0.78, 1e-4), (0.78, 0.05)])
def test_tangent_against_finite_differences(friction, sideways):
    """Without friction, sticking (small slip) and sliding (large slip)."""
    nodes, term = contact(friction, SPHERE)
    n = 3 * len(nodes)
    rng = np.random.default_rng(0)
    start = 1e-3 * rng.normal(size=n)
    term.begin_increment(state(start), state(start), pose(0.3, 0.2, 0.1), pose(0.3 + sideways, 0.2, 0.1), NEAR)
    update(term, state(start))
    x, v = start + 1e-5 * rng.normal(size=n), rng.normal(size=n)
    term.linearize(state(x))
    out = wp.zeros((n, 1), dtype=wp.float32, device="cpu")
    term.tangent(wp.array(v[:, None], dtype=wp.float32, device="cpu"), out)
    h = 1e-8
    difference = (forces(term, state(x + h * v)) - forces(term, state(x - h * v))) / (2 * h)
    error = np.linalg.norm(difference - out.numpy()[:, 0]) / np.linalg.norm(difference)
    # The friction tangent leaves out how the tangent plane turns: |tau| / R against k, below 1 %.
    assert error < (1e-6 if friction == 0.0 else 1e-2)


def test_multipliers_take_over_the_load():
    nodes, term = contact(0.0, CUBE)
    rest = state(np.zeros(3 * len(nodes)))
    term.set_pose(pose(0.0, 0.01, 0.0))
    change, size = update(term, rest)
    assert change[0] == pytest.approx(size[0])
    term.set_pose(pose(0.0, 0.0, 0.0))
    force = term.resultants(rest).force
    assert force[0, 1] == pytest.approx(K * 0.01 * 36.0)
    assert update(term, rest)[0][0] < 1e-12


@pytest.mark.parametrize(("slip", "expected"), [(1e-3, 15.0 * 1e-3 * 36.0), (1.0, 0.78 * 0.6 * 36.0)])
def test_friction_sticks_then_slides_on_the_cone(slip, expected):
    """Normal traction 0.6: sticking resists with k times slip, sliding with 0.78 times the normal force."""
    nodes, term = contact(0.78, CUBE)
    rest = state(np.zeros(3 * len(nodes)))
    down = pose(0.0, 0.01, 0.0)
    term.begin_increment(rest, rest, down, down, NEAR)
    update(term, rest)
    flush = pose(0.0, 0.0, 0.0)
    term.begin_increment(rest, rest, flush, pose(slip, 0.0, 0.0), NEAR)
    force = term.resultants(rest).force
    assert force[0, 0] == pytest.approx(expected, rel=1e-12)  # the gel is dragged along
    assert force[0, 1] == pytest.approx(0.6 * 36.0)


@pytest.mark.parametrize(("height", "counted"), [(0.0, 1.0), (0.03, 0.25), (0.05, 0.0)])
def test_slip_counts_from_entry(height, counted):
    """A shape that moves 0.04 down and 0.004 sideways: a surface 0.03 below it slips for the last quarter alone."""
    nodes, term = contact(0.78, CUBE)
    rest = state(np.zeros(3 * len(nodes)))
    start, end = pose(0.0, -height, 0.0), pose(0.004, 0.04 - height, 0.0)
    term.begin_increment(rest, rest, start, end, NEAR)
    slip = -0.004 - term.surface.anchor.numpy()[..., 0] + np.einsum("qa,fa->fq", term.surface.shapes.numpy(),
           nodes[term.host_faces][:, :, 0])[:, :, None]  # fmt: skip
    np.testing.assert_allclose(slip, -0.004 * counted, atol=1e-12)


def test_rest_overlap_may_count_as_touching():
    nodes, term = contact(0.0, CUBE)
    rest = state(np.zeros(3 * len(nodes)))
    term.set_pose(pose(0.0, 0.2, 0.0))
    term.set_shapes([CUBE], count_overlap_as_touching=rest)
    np.testing.assert_allclose(term.gap(rest), 0.0, atol=1e-12)
    assert np.abs(forces(term, rest)).max() < 1e-9


def test_shapes_and_poses_belong_to_their_environment():
    nodes, _, _, faces = box()
    active = ActiveEnvironments(2, "cpu")
    term = Contact(P2P1, nodes, top(nodes, faces), STIFFNESS, 0.0, "cpu", active)
    term.set_shapes([SPHERE, CUBE])
    term.set_pose(np.concatenate([pose(0.0, 0.2, 0.0), pose(0.0, 0.01, 0.0)]))
    rest = state(np.zeros((3 * len(nodes), 2)))
    together = term.resultants(rest).force
    for env, (shape, depth) in enumerate([(SPHERE, 0.2), (CUBE, 0.01)]):
        _, single = contact(0.0, shape)
        single.set_pose(pose(0.0, depth, 0.0))
        alone = state(np.zeros(3 * len(nodes)))
        np.testing.assert_array_equal(together[env], single.resultants(alone)[0][0])


def test_environments_choose_among_the_shapes():
    nodes, _, _, faces = box()
    term = Contact(P2P1, nodes, top(nodes, faces), STIFFNESS, 0.0, "cpu", ActiveEnvironments(2, "cpu"))
    term.set_shapes([SPHERE, CUBE, SPHERE])
    term.choose(np.array([1, 0]))
    term.set_pose(np.concatenate([pose(0.0, 0.1, 0.0)] * 2))
    rest = state(np.zeros((3 * len(nodes), 2)))
    flat, round_ = term.resultants(rest).force
    assert flat[1] == pytest.approx(K * 0.1 * 36.0) and round_[1] < 0.3 * flat[1]


def test_an_increment_is_taken_back_where_it_is_marked():
    """Multipliers and anchors of one environment return to where the increment began, those of the other stay."""
    nodes, term = contact(0.78, CUBE, n_env=2)
    rest = state(np.zeros((3 * len(nodes), 2)))
    down = np.concatenate([pose(0.0, 0.01, 0.0)] * 2)
    term.set_pose(down)
    update(term, rest)
    before = term.surface.normal.numpy().copy()
    term.begin_increment(rest, rest, down, np.concatenate([pose(0.0, 0.02, 0.0)] * 2), np.ones(2))
    update(term, rest)
    after = term.surface.normal.numpy().copy()
    assert (after > 1.5 * before).all()
    term.restore(ActiveEnvironments.of(np.array([False, True]), "cpu"))
    np.testing.assert_array_equal(term.surface.normal.numpy(), np.column_stack([after[:, 0], before[:, 1]]))
    term.forget(ActiveEnvironments.of(np.array([True, False]), "cpu"))
    np.testing.assert_array_equal(term.surface.normal.numpy(), np.column_stack([0.0 * after[:, 0], before[:, 1]]))


def test_multipliers_go_on_along_the_last_increment_that_was_kept():
    """From 0 to 0.1 E in an increment that is kept; half as far again, and back beyond zero, where there is no pull."""
    nodes, term = contact(0.78, CUBE)
    rest, everywhere = state(np.zeros(3 * len(nodes))), ActiveEnvironments(1, "cpu")
    down = pose(0.0, 0.01, 0.0)

    def begin(factor):
        term.begin_increment(rest, rest, down, down, NEAR)
        term.extrapolate(np.array([factor]))
        return term.surface.normal.numpy().copy(), term.surface.tangential.numpy().copy()

    assert not begin(1.0)[0].any()  # nothing before
    update(term, rest)
    term.surface.tangential.assign(np.broadcast_to([0.02, 0.0, -0.01], (*term.surface.tangential.shape, 3)))
    normal, tangential = term.surface.normal.numpy().copy(), term.surface.tangential.numpy().copy()
    assert normal.min() > 0.0
    term.keep(everywhere)
    for factor, share in ((0.5, 1.5), (-2.0, -1.0), (0.0, 1.0)):
        found = begin(factor)
        np.testing.assert_allclose(found[0], max(share, 0.0) * normal, rtol=1e-14)
        np.testing.assert_allclose(found[1], share * tangential, rtol=1e-14)
        term.restore(everywhere)
        np.testing.assert_array_equal(term.surface.normal.numpy(), normal)
    term.forget(everywhere)
    assert not begin(1.0)[0].any()  # another press knows nothing of it


def test_the_nearest_point_is_looked_for_between_the_integration_points():
    nodes, term = contact(0.0, SPHERE)
    rest = state(np.zeros(3 * len(nodes)))
    term.set_pose(pose(0.0, -0.1, 0.0))
    dense = wp.array(dense_shapes(12, linear=False), dtype=wp.float64, device="cpu")
    assert term.nearest(rest, dense)[0] == pytest.approx(0.1, abs=1e-12)  # the middle of the top is a point
    assert term.gap(rest).min() > 0.1001


@pytest.mark.parametrize("height, room", [(1.0, 0.9), (0.05, -0.05)])
def test_room_is_what_is_left_between_two_shapes(height, room):
    """Two spheres with their tips at y = 0.1 and at a height, the surface at y = 0."""
    nodes, term = contact(0.0, SPHERE)
    _, other = contact(0.0, SPHERE)
    rest, dense = state(np.zeros(3 * len(nodes))), wp.array(dense_shapes(12, linear=False), dtype=wp.float64)
    facing = pose(0.0, height, 0.0)
    facing[0, :3, :3] = np.diag([1.0, -1.0, -1.0])
    other.set_pose(facing)
    term.set_pose(pose(0.0, 0.1, 0.0))
    assert term.room(rest, dense, other) == pytest.approx(room, abs=1e-12)
    term.set_pose(pose(0.0, -0.01, 0.0))
    assert term.room(rest, dense, other) == np.inf  # nothing overlaps


@wp.kernel
def least_gap_kernel(s: Surface, x: wp.array2d(dtype=wp.float64), least_out: wp.array2d(dtype=wp.float64)):
    f, env = wp.tid()
    least_out[f, env] = gap_lower_bound(s, face_positions(s, x, f, env), env)


def least_gaps(term, x):
    least = wp.zeros((len(term.host_faces), 1), dtype=wp.float64, device="cpu")
    wp.launch(least_gap_kernel, dim=least.shape, inputs=[term.surface, x], outputs=[least], device="cpu")
    return least.numpy()[:, 0]


@pytest.mark.parametrize("kind", ["sphere", "cube", "sampled"])
def test_the_gap_of_a_whole_face_has_a_lower_bound(kind):
    """No point of a face, however bent, is nearer."""
    sampled = sampled_shape(trimesh.creation.icosphere(subdivisions=3, radius=2e-3), 0.25, 0.5)
    shape = {"sphere": SPHERE, "cube": CUBE, "sampled": sampled}[kind]
    nodes, term = contact(0.0, shape)
    rng, dense = np.random.default_rng(5), dense_shapes(12, linear=False)
    for height in (-1.0, 0.5, 20.0):
        x = state(0.3 * rng.normal(size=3 * len(nodes)))  # edges are 2 mm long
        term.set_pose(pose(0.4, -height, 0.2))
        positions = (nodes + x.numpy().reshape(-1, 3))[term.host_faces]
        points = np.einsum("qa,fai->fqi", dense, positions) - [0.4, -height, 0.2]
        truth = signed_distance(shape, points.reshape(-1, 3))[0].reshape(points.shape[:2]).min(axis=1)
        assert (least_gaps(term, x) <= truth + 1e-12).all()


@pytest.mark.parametrize("edge", [0, 1, 2])
def test_the_lower_bound_knows_how_far_a_face_bulges(edge):
    """The middle of an edge is pulled by 6 mm, three edges: the bound goes to the Bezier point, 12 mm further out."""
    nodes, term = contact(0.0, SPHERE)
    face = nodes[term.host_faces[0]].copy()
    face[3 + edge] += [0.0, 0.0, 6.0]
    u = np.zeros_like(nodes)
    u[term.host_faces[0]] = face - nodes[term.host_faces[0]]
    term.set_pose(pose(0.0, -100.0, 0.0))  # far below, so that distances hardly change over a face
    middle = face[:3].mean(axis=0)
    control = 2.0 * face[3 + edge] - 0.5 * (face[edge] + face[(edge + 1) % 3])
    expected = signed_distance(SPHERE, middle[None] + [[0.0, 100.0, 0.0]])[0][0]
    expected -= 1.65 * np.linalg.norm(control - middle)
    assert np.linalg.norm(control - middle) > 10.0
    assert least_gaps(term, state(u.ravel()))[0] == pytest.approx(expected, abs=1e-12)


def test_only_faces_that_can_touch_are_candidates():
    """A small sphere over a corner: near faces, at once or after a longer way, and those whose multipliers press."""
    nodes, term = contact(0.0, rigid_shape(Kind.SPHERE, 0.5))
    rest = state(np.zeros(3 * len(nodes)))
    assert term.surface.count.numpy()[0] == len(term.host_faces)  # before an increment begins
    counts = []
    for travel in (0.0, 2.0, 10.0):
        here = pose(2.5, -0.1, 2.5)
        term.begin_increment(rest, rest, here, here, np.array([travel]))
        counts.append(int(term.surface.count.numpy()[0]))
        chosen = term.surface.candidates.numpy()[: counts[-1], 0]
        gap = term.gap(rest)[:, :, 0].min(axis=1)
        assert set(chosen) == set(np.flatnonzero(gap < travel + 2.0))  # faces have edges of 2 mm
    assert 0 < counts[0] < counts[1] < counts[2] == len(term.host_faces)
    term.surface.normal.fill_(1.0)
    term.begin_increment(rest, rest, pose(0.0, -50.0, 0.0), pose(0.0, -50.0, 0.0), NEAR)
    assert term.surface.count.numpy()[0] == len(term.host_faces)
