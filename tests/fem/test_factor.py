"""The factor of linear tetrahedra inverts their tangent, and is made anew where it has become a poor one."""

import numpy as np
import warp as wp

from simgen.fem.element import P1
from simgen.fem.factor import REFACTOR_ABOVE, CornerFactor
from simgen.fem.material import NeoHookean
from simgen.fem.operator import Elasticity

from .box import box


def test_a_factor_inverts_the_tangent_it_was_made_of():
    nodes, tets, n_corners, _ = box()
    nodes = nodes[:n_corners]
    active = wp.ones(1, dtype=wp.int32, device="cpu")
    body = Elasticity(P1, nodes, tets, n_corners, NeoHookean.from_engineering(1.0, 0.499, None), "cpu", active)
    held = np.repeat(nodes[:, 1] > 4.0 - 1e-9, 3)
    factor = CornerFactor(body, [], wp.array(held.astype(np.int32), dtype=wp.int32, device="cpu"))
    rng = np.random.default_rng(0)
    first, second = (np.where(held, 0.0, 0.05 * rng.normal(size=held.shape)) for _ in range(2))
    v = np.where(held, 0.0, rng.normal(size=held.shape))

    def error(x) -> float:
        """Of K^-1 (K v) with the factor, K at state x."""
        body.linearize(wp.array(x[:, None], dtype=wp.float64, device="cpu"))
        force, found = (wp.zeros((len(v), 1), dtype=wp.float64, device="cpu") for _ in range(2))
        body.tangent(wp.array(v[:, None], dtype=wp.float64, device="cpu"), force)
        factor.apply(force, found)
        return np.linalg.norm(found.numpy()[:, 0] - v) / np.linalg.norm(v)

    body.linearize(wp.array(first[:, None], dtype=wp.float64, device="cpu"))
    assert len(factor.update(np.array([0]), np.array([0]))) == 0
    assert error(first) < 1e-9
    assert error(second) > 1e-2
    factor.update(np.array([0]), np.array([REFACTOR_ABOVE]))
    assert error(second) > 1e-2  # still good enough
    factor.update(np.array([0]), np.array([REFACTOR_ABOVE + 1]))
    assert error(second) < 1e-9
    factor.forget()
    factor.update(np.array([0]), np.array([0]))
    assert error(second) < 1e-9


def test_a_singular_environment_is_named():
    nodes, tets, n_corners, _ = box()
    active = wp.ones(2, dtype=wp.int32, device="cpu")
    nodes = nodes[:n_corners]
    body = Elasticity(P1, nodes, tets, n_corners, NeoHookean.from_engineering(1.0, 0.3, None), "cpu", active)
    held = np.zeros(3 * n_corners, dtype=np.int32)
    held[::3] = 1
    held[1::3] = 1
    held[2::3] = 1
    held[3 * n_corners - 1] = 0  # one component is free
    factor = CornerFactor(body, [], wp.array(held, dtype=wp.int32, device="cpu"))
    body.linearize(wp.zeros((3 * n_corners, 2), dtype=wp.float64, device="cpu"))
    body._coefficients.zero_()
    body._cofactors.zero_()
    body.material = NeoHookean(0.0, 0.0, 0.0, 0.0)
    np.testing.assert_array_equal(factor.update(np.array([1]), np.zeros(2)), [1])
