"""The axisymmetric code, against homogeneous states, finite differences, and itself on a finer mesh."""

import numpy as np
import pytest

from simgen.verification.validate.layer_axisymmetric import (
    LAMBDA,
    MU,
    LayerElements,
    StickingPress,
    graded,
    sticking_forces,
)


def test_edges_are_equal_and_then_grow_to_the_end():
    x = graded(0.5, 2.0, 10.0)
    np.testing.assert_allclose(x[:5], [0.0, 0.5, 1.0, 1.5, 2.0])
    assert x[-1] == pytest.approx(10.0) and (np.diff(np.diff(x))[4:] > 0.0).all()


@pytest.fixture(scope="module")
def layer():
    return LayerElements(1.0, 2.0)


def stretched(layer, along: float, around: float) -> np.ndarray:
    """Unknowns of the state z -> along z, r -> around r, with its exact pressure."""
    x = np.zeros(layer.size)
    cells = layer.unknowns[:, :18]
    r, z = node_places(layer)
    x[cells[:, 0::2]] = (around - 1.0) * r[cells[:, 0::2] // 2]
    x[cells[:, 1::2]] = (along - 1.0) * z[cells[:, 1::2] // 2]
    x[layer.n_displacements :] = LAMBDA * (along * around**2 - 1.0)
    return x


def node_places(layer):
    """Places r, z of all nodes, which are numbered by columns."""
    r = layer.rest[:, 0]
    count = layer.n_displacements // 2 // len(r)
    top = graded(1.0, 2.0, 4.0)
    z = np.sort(np.concatenate([4.0 - top, 4.0 - 0.5 * (top[1:] + top[:-1])]))
    assert len(z) == count
    return np.repeat(r, count), np.tile(z, len(r))


def test_a_homogeneous_state_has_its_exact_forces(layer):
    """No force inside, and on the top the nominal stress times the area."""
    along, around = 0.9, 1.05
    total, _ = layer.forces(stretched(layer, along, around))
    J = along * around**2
    nominal = MU * (along - 1.0 / along) + LAMBDA * (J - 1.0) * J / along
    assert total[2 * layer.top + 1].sum() == pytest.approx(nominal * np.pi * 100.0, rel=1e-10)
    r, z = node_places(layer)
    inside = (z > 0.0) & (z < 4.0) & (r < 10.0)
    assert np.abs(total[: layer.n_displacements].reshape(-1, 2)[inside]).max() < 1e-9
    assert np.abs(total[layer.n_displacements :]).max() < 1e-12


def test_the_derivative_is_that_of_the_forces(layer):
    rng = np.random.default_rng(3)
    x = stretched(layer, 0.95, 1.02) + 1e-2 * rng.standard_normal(layer.size)
    way = rng.standard_normal(layer.size)
    ahead, behind = (layer.forces(x + sign * 1e-6 * way)[0] for sign in (1.0, -1.0))
    expected = (ahead - behind) / 2e-6
    np.testing.assert_allclose(layer.forces(x)[1] @ way, expected, atol=1e-5 * np.abs(expected).max())


def test_nodes_touch_one_by_one_and_stay_where_they_touched():
    press = StickingPress(0.4, 3.5, 2.0)
    for _ in range(4):
        press.hold(press.solve())
    np.testing.assert_allclose(np.linalg.norm(press.places, axis=1), 3.5, rtol=1e-9)
    where = press.places[2].copy()
    press.state = press.solve(press.state.depth + 0.05)
    np.testing.assert_allclose(press._from_centre(press.state.x, press.state.depth, [2])[0], where, atol=1e-9)


def test_the_force_converges():
    coarse, fine = (np.array(sticking_forces(3.5, (0.25, 0.5), edge)) for edge in (0.3, 0.2))
    np.testing.assert_allclose(coarse, fine, rtol=0.02)
