"""Multipliers, stiffness factors and anchors of a contact."""

import numpy as np
import pytest
import warp as wp

from simgen.fem.batch_arrays import ActiveEnvironments
from simgen.fem.contact.contact import Contact
from simgen.fem.contact.multipliers import way_until_entry
from simgen.fem.elements.element import P2P1
from tests.fem.box import box, top
from tests.fem.contact.pressed_box import CUBE, NEAR, STIFFNESS, K, contact, pose, state, update


@pytest.mark.parametrize("pressure, factor", [(0.9, 1.0), (1.1, 2.0), (3.0, 4.0), (4.0, 4.0), (99.0, 16.0)])
def test_stiffness_follows_the_pressure_in_powers_of_two(pressure, factor):
    """The pressure is counted in E, which is 1 here; the stiffness holds from the next increment on."""
    nodes, term = contact(0.0, CUBE)
    rest = state(np.zeros(3 * len(nodes)))
    term.surface.normal.fill_(pressure)
    touching, overlapping = pose(0.0, 0.0, 0.0), pose(0.0, 0.01, 0.0)
    term.begin_increment(rest, rest, touching, overlapping, NEAR)
    force = term.resultants(rest).read().force[0]
    np.testing.assert_allclose(force, [0.0, (pressure + factor * K * 0.01) * 36.0, 0.0], atol=1e-12)
    term.restore(ActiveEnvironments(1, "cpu"))
    force = term.resultants(rest).read().force[0]
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


def test_multipliers_take_over_the_load():
    nodes, term = contact(0.0, CUBE)
    rest = state(np.zeros(3 * len(nodes)))
    term.set_pose(pose(0.0, 0.01, 0.0))
    change, size = update(term, rest)
    assert change[0] == pytest.approx(size[0])
    term.set_pose(pose(0.0, 0.0, 0.0))
    force = term.resultants(rest).read().force
    assert force[0, 1] == pytest.approx(K * 0.01 * 36.0)
    assert update(term, rest)[0][0] < 1e-12


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


@wp.kernel(enable_backward=False)
def share_kernel(gaps: wp.array(dtype=wp.vec3d), ratio: wp.float64, share_out: wp.array(dtype=wp.float64)):
    i = wp.tid()
    share_out[i] = way_until_entry(gaps[i][0], gaps[i][1], gaps[i][2], ratio)


def shares(gaps, ratio: float) -> np.ndarray:
    """(n,) from gaps (n, 3): before, now, predicted."""
    out = wp.zeros(len(gaps), dtype=wp.float64, device="cpu")
    wp.launch(share_kernel, dim=len(gaps), inputs=[wp.array(gaps, dtype=wp.vec3d, device="cpu"), ratio], outputs=[out],
              device="cpu")  # fmt: skip
    return out.numpy()


@pytest.mark.parametrize("ratio", [1.0, 1.5])
def test_a_point_that_slows_down_before_its_entry_sticks_where_it_will_be(ratio):
    """With t increments until entry, the gap and the way left are t^(3/2). One enters later: its way ends before."""
    t = np.array([0.01, 0.2, 0.7, 1.0, 2.0])
    before, now = (t + 1.0) ** 1.5, t**1.5
    gaps = np.column_stack([before, now, now + ratio * (now - before)])
    way = shares(gaps, ratio) * ratio * (before - now)
    np.testing.assert_allclose(way[:4], now[:4], rtol=1e-12)
    assert way[4] < now[4]


def test_a_point_that_stays_away_or_has_no_past_goes_straight():
    gaps = np.array([[0.1, 0.03, -0.01], [0.02, 0.03, -0.01], [0.1, 0.03, 0.02]])
    np.testing.assert_allclose(shares(gaps, 0.0), [0.75, 0.75, 1.0])
    np.testing.assert_allclose(shares(gaps, 1.0)[1], 0.75)


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
