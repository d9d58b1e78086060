import numpy as np
import pytest
import warp as wp

from simgen.fem.batch_arrays import ActiveEnvironments
from simgen.fem.linear_solver.krylov import ConjugateResiduals, Dots
from simgen.fem.linear_solver.krylov_kernels import WINDOW


def solve(A, b, preconditioner, tolerance, size, active=None):
    """Systems A (env, n, n), b (n, env): solutions (n, env), iterations and relative residuals (env,)."""
    flags = np.ones(b.shape[1]) if active is None else np.asarray(active)
    flags = ActiveEnvironments.of(flags != 0, "cpu")
    krylov = ConjugateResiduals(len(b), size, "cpu", flags)
    x = wp.full(b.shape, 7.0, dtype=wp.float64, device="cpu")
    b = wp.array(b, dtype=wp.float64, device="cpu")
    action = lambda v, out: out.assign(np.einsum("eij,je->ie", A, v.numpy()))  # noqa: E731
    used, relative = krylov.solve(action, lambda v, out: out.assign(preconditioner(v.numpy())), b, x, tolerance)
    return x.numpy(), used, relative


def test_every_environment_solves_its_own_system_and_stops_by_itself():
    rng = np.random.default_rng(0)
    n, n_env = 40, 3
    A = rng.normal(size=(n_env, n, n)) / np.sqrt(n) + np.array([2.0, 10.0, 3.0])[:, None, None] * np.eye(n)
    b = rng.normal(size=(n, n_env)) * np.array([1.0, 1e-9, 1.0])  # forces may be small
    x, used, relative = solve(A, b, lambda v: v / np.einsum("eii->ie", A), 1e-5, n, [1, 1, 0])
    assert (relative[:2] <= 1e-5).all()
    assert used[1] < used[0] <= n
    for env in (0, 1):
        true = b[:, env] - A[env] @ x[:, env]
        assert np.linalg.norm(true) <= 1.1e-5 * np.linalg.norm(b[:, env])  # the recurrence tells the true residual
    assert (x[:, 2] == 7.0).all() and used[2] == 0  # left as it was


def test_an_environment_alone_is_solved_as_among_others():
    rng = np.random.default_rng(3)
    A, b = rng.normal(size=(3, 30, 30)) / 6 + 2.0 * np.eye(30), rng.normal(size=(30, 3))
    together = solve(A, b, lambda v: v, 1e-3, 30)
    for env in range(3):
        alone = solve(A[env : env + 1], b[:, env : env + 1], lambda v: v, 1e-3, 30)
        np.testing.assert_allclose(alone[0][:, 0], together[0][:, env], rtol=0, atol=1e-5)
        assert alone[1][0] == together[1][env]


def test_the_size_bounds_the_iterations_and_the_residual_says_so():
    rng = np.random.default_rng(1)
    A, b = rng.normal(size=(1, 30, 30)) + 2.0 * np.eye(30), rng.normal(size=(30, 1))
    x, used, relative = solve(A, b, lambda v: v, 1e-5, 5)
    assert used[0] == 5
    assert relative[0] > 1e-5
    assert np.isclose(relative[0], np.linalg.norm(b - A[0] @ x) / np.linalg.norm(b), rtol=1e-5)


def test_an_environment_that_breaks_down_does_not_stop_the_others():
    rng = np.random.default_rng(2)
    A = np.tile(rng.normal(size=(20, 20)) / 5 + 4.0 * np.eye(20), (2, 1, 1))
    b = rng.normal(size=(20, 2))
    A[1, 0, 0] = np.nan
    x, _, relative = solve(A, b, lambda v: v, 1e-5, 20)
    assert relative[1] == np.inf and relative[0] <= 1e-5
    assert np.linalg.norm(b[:, 0] - A[0] @ x[:, 0]) <= 1.1e-5 * np.linalg.norm(b[:, 0])


def test_nothing_to_solve():
    x, used, relative = solve(np.eye(4)[None], np.zeros((4, 1)), lambda v: v, 1e-5, 4)
    assert np.abs(x).max() == 0.0 and used[0] == 0 and relative[0] == 0.0


def test_a_residual_that_does_not_change_at_first_is_no_end():
    """A cyclic shift of n: no direction made of residuals alone helps before the last."""
    n = 12
    A, b = np.roll(np.eye(n), 1, axis=0)[None], np.eye(n)[:, :1]
    x, used, relative = solve(A, b, lambda v: v, 1e-5, 20)
    assert used[0] == n and relative[0] <= 1e-5
    np.testing.assert_allclose(A[0] @ x, b, atol=1e-6)


def test_a_system_takes_more_iterations_than_images_are_kept():
    rng = np.random.default_rng(5)
    n = 120
    skew = rng.normal(size=(n, n))
    A = (np.diag(np.geomspace(1.0, 300.0, n)) + 0.02 * (skew - skew.T))[None]
    b = rng.normal(size=(n, 1))
    x, used, relative = solve(A, b, lambda v: v, 1e-3, n)
    assert used[0] > 2 * WINDOW and relative[0] <= 1e-3
    assert np.linalg.norm(b[:, 0] - A[0] @ x[:, 0]) <= 1.1e-3 * np.linalg.norm(b)


def test_a_system_that_has_come_to_its_end_is_left_alone():
    """One stops at the most iterations that there is room for, the other goes on: nothing is written beyond."""
    A = np.stack([np.eye(30) + np.diag(np.ones(29), 1) * 3.0, np.diag(np.linspace(1.0, 3.0, 30))])
    b = np.random.default_rng(6).normal(size=(30, 2))
    flags = ActiveEnvironments(2, "cpu")
    krylov = ConjugateResiduals(30, 6, "cpu", flags)
    krylov._steps = wp.full((6, 2), 7.0, dtype=wp.float64, device="cpu")
    whole = wp.full((7, 6, 2), 7.0, dtype=wp.float64, device="cpu")  # with a plane behind what there is room for
    krylov._products = whole[:6]
    right, x = (wp.array(values, dtype=wp.float64, device="cpu") for values in (b, np.zeros((30, 2))))
    action = lambda v, out: out.assign(np.einsum("eij,je->ie", A, v.numpy()))  # noqa: E731
    flags.choose(np.array([True, False]))
    krylov.begin(right)
    assert not krylov.advance(action, lambda v, out: wp.copy(out, v), 1e-9, 1e-9, most=6).any()
    flags.choose(np.array([False, True]))
    krylov.begin(right)
    krylov.advance(action, lambda v, out: wp.copy(out, v), 1e-9, 1e-9, most=6)
    assert (whole.numpy()[6] == 7.0).all()
    flags.choose(np.array([True, True]))
    used, _ = krylov.end(x)
    assert used.tolist() == [6, 6]


def test_products_of_environments_that_are_not_listed_stay():
    flags = ActiveEnvironments(2, "cpu")
    ones, dots = wp.ones((4, 2), dtype=wp.float32, device="cpu"), Dots(4, flags)
    assert dots(ones, ones).numpy().tolist() == [4.0, 4.0]
    flags.choose(np.array([False, True]))
    assert dots(ones, ones).numpy().tolist() == [4.0, 4.0]


def test_a_system_that_begins_later_and_one_that_waits_are_solved_as_alone():
    """Iterations are carried on two at a time; the second system begins when the first is under way."""
    rng = np.random.default_rng(4)
    A, b = rng.normal(size=(2, 30, 30)) / 6 + 2.0 * np.eye(30), rng.normal(size=(30, 2))
    flags = ActiveEnvironments(2, "cpu")
    krylov = ConjugateResiduals(30, 30, "cpu", flags)
    x, right = (wp.array(values, dtype=wp.float64, device="cpu") for values in (np.zeros((30, 2)), b))
    action = lambda v, out: out.assign(np.einsum("eij,je->ie", A, v.numpy()))  # noqa: E731
    going, used, rounds = np.zeros(2, dtype=bool), np.zeros(2, dtype=int), 0
    for starts in (0, 1, None, *[None] * 30):
        if starts is not None:
            flags.choose(np.arange(2) == starts)
            krylov.begin(right)
            going[starts] = True
        if not going.any():
            break
        flags.choose(going)
        still = krylov.advance(action, lambda v, out: wp.copy(out, v), 1e-4, 1e-4, most=2)
        flags.choose(going & ~still)
        iterations, relative = krylov.end(x)
        used[going & ~still] = iterations[going & ~still]
        assert (relative[going & ~still] <= 1e-4).all()
        going, rounds = still, rounds + 1
    assert not going.any() and rounds == -(-used[1] // 2) + 1 >= 4
    for env in range(2):
        alone = solve(A[env : env + 1], b[:, env : env + 1], lambda v: v, 1e-4, 30)
        np.testing.assert_array_equal(x.numpy()[:, env], alone[0][:, 0])
        assert alone[1][0] == used[env]


def test_systems_that_go_on_together_take_as_many_iterations():
    """One is solved at once, the other after some: the first goes on with it; alone it stops."""
    hard, easy = np.diag(np.geomspace(1.0, 1e3, 40)), np.eye(40) + np.diag(np.full(39, 0.1), 1)
    A, b = np.stack([hard, easy]), np.random.default_rng(7).normal(size=(40, 2))
    right = wp.array(b, dtype=wp.float64, device="cpu")
    action = lambda v, out: out.assign(np.einsum("eij,je->ie", A, v.numpy()))  # noqa: E731
    copy = lambda v, out: wp.copy(out, v)  # noqa: E731
    counts = {}
    for together in (0, 2, 3):
        flags = ActiveEnvironments(2, "cpu")
        krylov = ConjugateResiduals(40, 40, "cpu", flags)
        krylov.begin(right)
        still = krylov.advance(action, copy, 0.2, 0.2, most=3, together=together)
        assert still.tolist() == [True, False]
        flags.choose(np.ones(2, dtype=bool))
        x = wp.zeros((40, 2), dtype=wp.float64, device="cpu")
        counts[together], relative = krylov.end(x)
        left = np.linalg.norm(easy @ x.numpy()[:, 1] - b[:, 1]) / np.linalg.norm(b[:, 1])
        assert left == pytest.approx(relative[1], rel=1e-3) and left < 0.2
    assert counts[0].tolist() == [3, 1] and counts[2].tolist() == [3, 2]
    assert counts[3][0] == 3 and 2 < counts[3][1] <= 3


def test_a_system_that_was_solved_stays_so_when_it_breaks_down():
    """The matrix has a zero: what is left after one iteration has no image. Alone the system would have stopped."""
    A, b = np.stack([np.diag([1.0] * 39 + [0.0]), np.diag(np.geomspace(1.0, 1e3, 40))]), np.ones((40, 2))
    b[39, 0] = 0.3
    action = lambda v, out: out.assign(np.einsum("eij,je->ie", A, v.numpy()))  # noqa: E731
    for tolerance, solved in ((0.1, True), (0.01, False)):
        flags = ActiveEnvironments(2, "cpu")
        krylov = ConjugateResiduals(40, 40, "cpu", flags)
        krylov.begin(wp.array(b, dtype=wp.float64, device="cpu"))
        krylov.advance(action, lambda v, out: wp.copy(out, v), tolerance, tolerance, most=5, together=5)
        flags.choose(np.array([True, False]))
        x = wp.zeros((40, 2), dtype=wp.float64, device="cpu")
        _, relative = krylov.end(x)
        assert (relative[0] <= tolerance) == solved
        if solved:
            left = np.linalg.norm(A[0] @ x.numpy()[:, 0] - b[:, 0]) / np.linalg.norm(b[:, 0])
            assert left == pytest.approx(relative[0], rel=1e-3)


def test_a_residual_that_stays_put_for_long_does_not_overflow():
    """A cyclic shift leaves the residual as it is until the last iteration, and its images grow by 1e6 each time."""
    n = 12
    A = 1e6 * np.roll(np.eye(n), 1, axis=0)[None]
    b = np.eye(n)[:, :1]
    x, used, relative = solve(A, b, lambda v: v, 1e-4, n)
    assert used[0] == n <= WINDOW and relative[0] <= 1e-4
    np.testing.assert_allclose(A[0] @ x, b, atol=2e-4)
