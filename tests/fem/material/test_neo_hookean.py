"""Derivatives against finite differences, and the invariances that any solid must have."""

import numpy as np
import pytest
import warp as wp

from simgen.fem.material.neo_hookean import (
    LEAST_LOGARITHM,
    NeoHookean,
    cofactor,
    first_piola,
    first_piola_increment,
    tangent_transposed,
    tangent_volumetric,
)
from simgen.fem.precision import mat33

MU, GAMMA, P = 0.7, 1.3, 0.4


@wp.kernel(enable_backward=False)
def evaluate(
    F: wp.array(dtype=mat33),
    dF: wp.array(dtype=mat33),
    p: wp.float64,
    dp: wp.float64,
    mu: wp.float64,
    gamma: wp.float64,
    P_out: wp.array(dtype=mat33),
    dP_out: wp.array(dtype=mat33),
):
    i = wp.tid()
    J = wp.determinant(F[i])
    cof = cofactor(F[i])
    metric = mu * wp.identity(n=3, dtype=wp.float64)
    P_out[i] = first_piola(F[i], cof, metric, J, p, mu, gamma)
    alpha = tangent_transposed(J, p, mu, gamma)
    beta = tangent_volumetric(J, p, mu, gamma)
    dP_out[i] = first_piola_increment(dF[i], cof, metric, alpha, beta, dp)


def stress(F, dF=None, p=P, dp=0.0, mu=MU, gamma=GAMMA):
    F = np.ascontiguousarray(F, dtype=float).reshape(-1, 3, 3)
    dF = np.zeros_like(F) if dF is None else np.ascontiguousarray(dF).reshape(-1, 3, 3)
    out = [wp.zeros(len(F), dtype=mat33, device="cpu") for _ in range(2)]
    arrays = [wp.array(a, dtype=mat33, device="cpu") for a in (F, dF)]
    wp.launch(evaluate, dim=len(F), inputs=[*arrays, p, dp, mu, gamma], outputs=out, device="cpu")
    return out[0].numpy(), out[1].numpy()


def logarithm(J):
    """ln J, below J0 its Taylor polynomial of second order there."""
    if J > LEAST_LOGARITHM:
        return np.log(J)
    step = J / LEAST_LOGARITHM - 1.0
    return np.log(LEAST_LOGARITHM) + step - step**2 / 2


def energy(F, p=P):
    J = np.linalg.det(F)
    return MU / 2 * (np.sum(F * F) - 3 - 2 * logarithm(J)) + GAMMA / 2 * (J - 1) ** 2 + p * (J - 1)


@pytest.fixture(params=[1.0, 0.02, -0.01, -0.3], ids=lambda share: f"flattened to {share}")
def F(request):
    """About the identity, all but flat, and inside out, a little and by far."""
    F = np.eye(3) + 0.2 * np.random.default_rng(3).normal(size=(3, 3))
    return np.diag([1.0, request.param, 1.0]) @ F


def test_stress_is_the_derivative_of_the_energy(F):
    h = 1e-6
    difference = np.zeros((3, 3))
    for i, j in np.ndindex(3, 3):
        step = np.zeros((3, 3))
        step[i, j] = h
        difference[i, j] = (energy(F + step) - energy(F - step)) / (2 * h)
    np.testing.assert_allclose(stress(F)[0][0], difference, atol=1e-9)  # h^2 and rounding / h


def test_tangent_is_the_derivative_of_the_stress_with_a_v_shaped_error(F):
    dF, dp = np.random.default_rng(4).normal(size=(3, 3)), 0.8
    exact = stress(F, dF, dp=dp)[1][0]
    error = {}
    for h in (1e-2, 1e-3, 1e-6, 1e-12):
        forward, back = stress(F + h * dF, p=P + h * dp)[0][0], stress(F - h * dF, p=P - h * dp)[0][0]
        error[h] = np.linalg.norm((forward - back) / (2 * h) - exact)
    assert error[1e-2] / error[1e-3] == pytest.approx(100.0, rel=0.2)  # second order
    assert error[1e-6] < 1e-9 * (1.0 + np.abs(exact).max()) < error[1e-12]  # truncation gone; rounding takes over


def test_rest_is_free_of_stress_and_frames_do_not_matter(F):
    assert np.abs(stress(np.eye(3), p=0.0)[0]).max() < 1e-15
    Q, _ = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))
    Q *= np.sign(np.linalg.det(Q))
    np.testing.assert_allclose(stress(Q @ F)[0][0], Q @ stress(F)[0][0], atol=1e-14)


def test_small_strain_limit_is_hooke():
    solid = NeoHookean.from_engineering(1.0, 0.499, 2.0)
    e = 1e-7 * np.random.default_rng(6).normal(size=(3, 3))
    e = e + e.T
    p = (solid.lam - solid.gamma) * np.trace(e)
    hooke = 2 * solid.mu * e + solid.lam * np.trace(e) * np.eye(3)
    error = np.abs(stress(np.eye(3) + e, p=p, mu=solid.mu, gamma=solid.gamma)[0][0] - hooke).max()
    assert error < 1e-5 * np.abs(hooke).max()  # the next order of the strain, times lam / mu


def test_lame_parameters():
    solid = NeoHookean.from_engineering(0.539, 0.499, 2.0)
    assert solid.mu == pytest.approx(0.17979, abs=1e-5)  # E / (2 (1 + nu))
    assert solid.lam == pytest.approx(89.7135, abs=1e-4)  # 2 mu nu / (1 - 2 nu)
    assert solid.gamma == pytest.approx(2.0 * solid.mu)
    assert NeoHookean.from_engineering(1.0, 0.3, None).pressure_compliance == 0.0
    compressible = NeoHookean.from_engineering(1.0, 0.2, 2.0)
    assert compressible.gamma == pytest.approx(compressible.lam / 2.0)
    with pytest.raises(ValueError, match=r"poisson_ratio = 0\.5"):
        NeoHookean.from_engineering(1.0, 0.5, 2.0)
