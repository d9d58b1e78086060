"""One contact in several environments, and its increments."""

import numpy as np
import pytest

from simgen.fem.batch_arrays import ActiveEnvironments
from simgen.fem.contact.contact import Contact
from simgen.fem.elements.element import P2P1
from tests.fem.box import box, top
from tests.fem.contact.pressed_box import CUBE, SPHERE, STIFFNESS, K, contact, forces, pose, state, update


def test_rest_overlap_may_count_as_touching():
    nodes, term = contact(0.0, CUBE)
    rest = state(np.zeros(3 * len(nodes)))
    term.set_pose(pose(0.0, 0.2, 0.0))
    term.set_shapes([CUBE], touching_state=rest)
    np.testing.assert_allclose(term.gap(rest), 0.0, atol=1e-12)
    assert np.abs(forces(term, rest)).max() < 1e-9



def test_shapes_and_poses_belong_to_their_environment():
    nodes, _, _, faces = box()
    active = ActiveEnvironments(2, "cpu")
    term = Contact(P2P1, nodes, top(nodes, faces), STIFFNESS, 0.0, "cpu", active)
    term.set_shapes([SPHERE, CUBE])
    term.set_pose(np.concatenate([pose(0.0, 0.2, 0.0), pose(0.0, 0.01, 0.0)]))
    rest = state(np.zeros((3 * len(nodes), 2)))
    together = term.resultants(rest).read().force
    for env, (shape, depth) in enumerate([(SPHERE, 0.2), (CUBE, 0.01)]):
        _, single = contact(0.0, shape)
        single.set_pose(pose(0.0, depth, 0.0))
        alone = state(np.zeros(3 * len(nodes)))
        np.testing.assert_array_equal(together[env], single.resultants(alone).read()[0][0])



def test_environments_choose_among_the_shapes():
    nodes, _, _, faces = box()
    term = Contact(P2P1, nodes, top(nodes, faces), STIFFNESS, 0.0, "cpu", ActiveEnvironments(2, "cpu"))
    term.set_shapes([SPHERE, CUBE, SPHERE])
    term.choose(np.array([1, 0]))
    term.set_pose(np.concatenate([pose(0.0, 0.1, 0.0)] * 2))
    rest = state(np.zeros((3 * len(nodes), 2)))
    flat, round_ = term.resultants(rest).read().force
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
