"""Inverses of dense matrices in many environments."""

import numpy as np
import pytest
import warp as wp

from simgen.fem.batch_arrays import ActiveEnvironments
from simgen.fem.linear_solver import dense_inverse


def spd(rows: int, rng) -> np.ndarray:
    root = rng.normal(size=(rows, rows))
    return root @ root.T + rows * np.eye(rows)


def test_an_inverse_is_that_of_its_own_environment():
    """One that is not active stays; so does the order of entries in the tiles."""
    rng, m = np.random.default_rng(0), dense_inverse.padded(21)
    assert m == 32
    matrices = dense_inverse.zeros(m, 3, "cpu")
    exact = [spd(m, rng) for _ in range(3)]
    matrices.assign(np.stack([a.ravel() for a in exact], axis=-1)[None])
    active = ActiveEnvironments(3, "cpu")
    active.assign(np.array([2, 0, -1], dtype=np.int32))
    dense_inverse.Inverter(matrices, m, active)()
    for env in (0, 2):
        found = matrices.numpy()[0, :, env].reshape(m, m)
        np.testing.assert_allclose(found @ exact[env], np.eye(m), atol=1e-4)
    np.testing.assert_allclose(matrices.numpy()[0, :, 1], exact[1].ravel(), rtol=1e-6)


@pytest.mark.parametrize("few", [False, True])
def test_products_are_those_of_numpy(few, monkeypatch):
    """Also with parts of 8 columns, as on a GPU in few environments."""
    monkeypatch.setattr(ActiveEnvironments, "few", few)
    rng, m, n_env = np.random.default_rng(1), 16, 40  # two tiles
    host = np.stack([spd(m, rng) for _ in range(n_env)]).astype(np.float32)
    matrices = dense_inverse.zeros(m, n_env, "cpu")
    tiles = np.zeros(matrices.shape, dtype=np.float32)
    for env in range(n_env):
        tiles[env // 32, :, env % 32] = host[env].ravel()
    matrices.assign(tiles)
    x = rng.normal(size=(m, n_env)).astype(np.float32)
    y = wp.zeros((m, n_env), dtype=wp.float32, device="cpu")
    active = ActiveEnvironments(n_env, "cpu")
    dense_inverse.multiply(matrices, m, wp.array(x, dtype=wp.float32, device="cpu"), active, y)
    np.testing.assert_allclose(y.numpy(), np.einsum("eij,je->ie", host, x), rtol=1e-4, atol=1e-4)
