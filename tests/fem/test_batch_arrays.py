import numpy as np
import pytest
import warp as wp

from simgen.fem import batch_arrays
from simgen.fem.batch_arrays import ActiveEnvironments

ACTIVE = ActiveEnvironments.of(np.array([False, True, True]), "cpu")


def array(values, dtype=wp.float64):
    return wp.array(np.asarray(values, dtype=float), dtype=dtype, device="cpu")


def test_inactive_environments_stay():
    rng = np.random.default_rng(0)
    a, b, out = rng.normal(size=(3, 4, 3))
    factor = np.array([1.0, 0.5, -2.0])
    for act, expected in (
        (lambda x: batch_arrays.copy(array(a), ACTIVE, x), a),
        (lambda x: batch_arrays.clear(ACTIVE, x), 0.0 * a),
        (lambda x: batch_arrays.add_scaled(array(a), array(b), factor, ACTIVE, x), a + factor * b),
        (lambda x: batch_arrays.extrapolate(array(a), array(b), factor, ACTIVE, x), b + factor * (b - a)),
    ):
        found = array(out)
        act(found)
        np.testing.assert_array_equal(found.numpy()[:, 0], out[:, 0])
        np.testing.assert_allclose(found.numpy()[:, 1:], expected[:, 1:], rtol=1e-15)


def test_a_list_says_which_environments_take_part():
    for some in ([True, False, True], [False, False, False], [True, True, True]):
        numbers = batch_arrays.env_indices(np.array(some))
        assert numbers.tolist() == [i for i in range(3) if some[i]] + [-1] * (3 - sum(some))
        assert batch_arrays.env_mask(numbers).tolist() == some


def test_vectors_are_cleared_too():
    vectors = wp.array(np.ones((2, 3, 3)), dtype=wp.vec3d, device="cpu")
    batch_arrays.clear(ACTIVE, vectors)
    assert (vectors.numpy()[:, 0] == 1.0).all() and not vectors.numpy()[:, 1:].any()


@pytest.mark.parametrize("dtype", [wp.float64, wp.float32, wp.int32, wp.vec3d, wp.mat33d])
def test_columns_move_to_other_environments(dtype):
    shape = (3, 5, *getattr(dtype, "_shape_", ()))
    values = np.arange(np.prod(shape)).reshape(shape)
    array = wp.array(values, dtype=dtype, device="cpu")
    batch_arrays.move([array], ActiveEnvironments(5, "cpu"), np.array([4, 3]), np.array([0, 2]))
    np.testing.assert_array_equal(array.numpy(), values[:, [4, 1, 3, 3, 4]])


def test_few_environments_are_told_on_a_gpu_alone():
    active = ActiveEnvironments(64, "cpu")
    for exact, chosen, few in ((True, 1, False), (False, 1, True), (False, 32, True), (False, 33, False)):
        active._exact = exact
        active.choose(np.arange(64) < chosen)
        assert active.few == few and active.chosen.sum() == chosen


def test_a_list_is_written_again_only_after_a_change(monkeypatch):
    written, write = [], batch_arrays.write
    monkeypatch.setattr(batch_arrays, "write", lambda *given: written.append(given[0].tolist()) or write(*given))
    active, odd = ActiveEnvironments(4, "cpu"), np.arange(4) % 2 == 1
    for change in (lambda: active.choose(odd), active.shortened, lambda: active.assign(np.array([3, 1, -1, -1]))):
        before = len(written)
        change()
        active.choose(odd)
        active.choose(odd.copy())
        assert len(written) > before and active.numpy().tolist() == [1, 3, -1, -1]
    assert written == [[1, 3, -1, -1], [1, 3, -1, -1], [3, 1, -1, -1], [1, 3, -1, -1]]
    odd[0] = True
    active.choose(odd)
    assert active.numpy().tolist() == [0, 1, 3, -1]


@pytest.mark.parametrize(
    ("movable", "free", "expected"),
    [([0, 0, 1, 1], [1, 0, 0, 0], [(3, 0)]), ([0, 0, 1, 1], [1, 1, 0, 0], [(3, 0), (2, 1)]),
     ([1, 1, 0, 0], [0, 0, 1, 1], []), ([0, 1, 0, 1], [1, 0, 1, 0], [(3, 0)]), ([0, 0], [1, 1], [])],
)  # fmt: skip
def test_presses_move_only_to_lower_columns(movable, free, expected):
    sources, targets = batch_arrays.lower_columns(np.array(movable, dtype=bool), np.array(free, dtype=bool))
    assert list(zip(sources.tolist(), targets.tolist(), strict=True)) == expected
