"""Who goes first, and where an increment starts."""

import numpy as np
import pytest
from test_press import CUBE, DEPTHS, GEL, SPHERE, make_block, pose

from simgen import march
from simgen.distance import Kind
from simgen.fem import columns
from simgen.fem.contact import Contact
from simgen.press import Scene, press
from simgen.shape import rigid_shape


@pytest.fixture(scope="module")
def block():
    return make_block((4, 2, 4))


def test_presses_that_touch_the_most_go_first(monkeypatch):
    loaded = []
    load = Scene.load

    def watch(scene, environments, shape_of):
        loaded.append(int(shape_of[0]))
        load(scene, environments, shape_of)

    monkeypatch.setattr(Scene, "load", watch)
    small = rigid_shape(Kind.SPHERE, 0.8)
    results = press(Scene(make_block((8, 2, 8)), GEL), [small, CUBE, SPHERE], np.tile(pose(), (3, 1, 1)), DEPTHS)
    assert loaded[1:] == [1, 2, 0]  # the first call is the scene's own, back to rest
    forces = [np.linalg.norm(result.force[-1]) for result in results]
    assert forces[1] > forces[2] > forces[0]  # and the results come in the order of the presses


def test_a_start_that_is_rejected_is_made_nearer_by_thirds(block, monkeypatch):
    """No start is good enough for this bound: every increment begins from the last state as it is, and converges."""
    monkeypatch.setattr(march, "LEAST_GUESS_SHARE", 10.0)
    factors = []
    beyond = columns.go_beyond

    def watch(before, start, factor, marked, out):
        factors.append(factor.copy())
        beyond(before, start, factor, marked, out)

    monkeypatch.setattr(columns, "go_beyond", watch)
    depths = np.array([0.2e-3, 0.4e-3, 0.6e-3])
    alone = press(Scene(block, GEL), [SPHERE], pose(), depths)[0]
    assert (alone.status == 0).all() and alone.certificate["substeps"].tolist() == [1, 1, 1]
    whole = np.ravel(factors)[[0, 1, 2, 4, 6, 8, 9, 11, 13]]  # what surface points are said to do, nearer or not
    np.testing.assert_allclose(whole, [0.0, *8 * [1.0]], atol=1e-15)
    nearer = np.ravel(factors)[[3, 5, 7, 10, 12, 14]]
    np.testing.assert_allclose(nearer, 2 * [2.0 / 3.0, 1.0 / 3.0, 0.0], atol=1e-15)
    # Rejections of one press are not forgotten when another begins its increment.
    both = press(Scene(block, GEL, batch=2), [CUBE, SPHERE], np.tile(pose(), (2, 1, 1)), depths)
    np.testing.assert_array_equal(both[1].displacement, alone.displacement)


def test_multipliers_begin_where_they_were_when_a_start_is_rejected(block, monkeypatch):
    """All starts beyond are rejected; the one from the last state has its multipliers, whatever they were given."""
    monkeypatch.setattr(march, "LEAST_GUESS_SHARE", 10.0)
    began, kept = [], []
    extrapolate, keep = Contact.extrapolate, Contact.keep

    def watch_begin(contact, factor):
        extrapolate(contact, factor)
        began.append((float(factor[0]), contact.surface.normal.numpy().copy()))

    def watch_end(contact, marked):
        if marked.numpy()[0] >= 0:
            kept.append(contact.surface.normal.numpy().copy())
        keep(contact, marked)

    monkeypatch.setattr(Contact, "extrapolate", watch_begin)
    monkeypatch.setattr(Contact, "keep", watch_end)
    press(Scene(block, GEL), [SPHERE], pose(), np.array([0.2e-3, 0.4e-3, 0.6e-3]))
    assert [factor for factor, _ in began] == pytest.approx([0.0, *2 * [1.0, 2.0 / 3.0, 1.0 / 3.0, 0.0]])
    for (_, first), (_, last), end in ((began[1], began[4], kept[0]), (began[5], began[8], kept[1])):
        assert end.any() and np.abs(first - end).max() > 0.1 * end.max()
        np.testing.assert_array_equal(last, end)
