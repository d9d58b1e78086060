import numpy as np
import warp as wp

from simgen.fem.krylov import Gmres


def test_every_environment_solves_its_own_system():
    rng = np.random.default_rng(0)
    n, n_env = 40, 3
    A = rng.normal(size=(n_env, n, n)) / np.sqrt(n) + np.array([2.0, 3.0, 10.0])[:, None, None] * np.eye(n)
    b = rng.normal(size=(n, n_env))
    active = np.array([True, True, False])

    def operator(v, out):
        out.assign(np.einsum("eij,je->ie", A, v.numpy()))

    def jacobi(v, out):
        out.assign(v.numpy() / np.einsum("eii->ie", A))

    gmres, x = Gmres(n, n_env, n, "cpu"), wp.zeros((n, n_env), dtype=wp.float64, device="cpu")
    used, residual = gmres.solve(operator, jacobi, wp.array(b, dtype=wp.float64, device="cpu"), x, 1e-10, active)
    assert used <= n and (residual[active] <= 1e-10).all()
    for env in (0, 1):
        true = b[:, env] - A[env] @ x.numpy()[:, env]
        assert np.linalg.norm(true) <= 1.01e-10 * np.linalg.norm(b[:, env])  # the recurrence tells the true residual
    assert np.abs(x.numpy()[:, 2]).max() == 0.0


def test_the_basis_bounds_the_iterations_and_the_residual_says_so():
    rng = np.random.default_rng(1)
    A, b = rng.normal(size=(30, 30)), rng.normal(size=(30, 1))
    gmres, x = Gmres(30, 1, 5, "cpu"), wp.zeros((30, 1), dtype=wp.float64, device="cpu")
    used, residual = gmres.solve(
        lambda v, out: out.assign(A @ v.numpy()), lambda v, out: out.assign(v.numpy()),
        wp.array(b, dtype=wp.float64, device="cpu"), x, 1e-8, np.ones(1, dtype=bool),
    )  # fmt: skip
    assert used == 5
    assert residual[0] > 1e-8
    assert np.isclose(residual[0], np.linalg.norm(b - A @ x.numpy()) / np.linalg.norm(b))


def test_an_environment_that_breaks_down_does_not_stop_the_others():
    rng = np.random.default_rng(2)
    A = rng.normal(size=(20, 20)) / 5 + 4.0 * np.eye(20)
    b = rng.normal(size=(20, 2))

    def operator(v, out):
        action = A @ v.numpy()
        action[:, 1] = np.nan
        out.assign(action)

    gmres, x = Gmres(20, 2, 20, "cpu"), wp.zeros((20, 2), dtype=wp.float64, device="cpu")
    _, residual = gmres.solve(
        operator, lambda v, out: out.assign(v.numpy()), wp.array(b, dtype=wp.float64, device="cpu"), x, 1e-9,
        np.ones(2, dtype=bool),
    )  # fmt: skip
    assert residual[1] == np.inf and residual[0] <= 1e-9
    assert np.linalg.norm(b[:, 0] - A @ x.numpy()[:, 0]) <= 1.1e-9 * np.linalg.norm(b[:, 0])
