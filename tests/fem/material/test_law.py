"""Requirements on every law: derivatives against finite differences, invariances, small strains."""


import numpy as np
import pytest

from simgen.fem.material import LAWS
from simgen.fem.material.neo_hookean import NeoHookean
from simgen.fem.material.volume import LEAST_LOGARITHM
from tests.fem.material.points import GAMMA, MU, SOLIDS, P, stress, tangent


def logarithm(J):
    """ln J, below J0 its Taylor polynomial of second order there."""
    if J > LEAST_LOGARITHM:
        return np.log(J)
    step = J / LEAST_LOGARITHM - 1.0
    return np.log(LEAST_LOGARITHM) + step - step**2 / 2


def energy(solid, F, p=P):
    J, s = np.linalg.det(F), np.sum(F * F) - 3
    shape = sum(c * s**power for power, c in enumerate((MU / 2, *solid.kernel_constants), start=1))
    return shape - MU * logarithm(J) + GAMMA / 2 * (J - 1) ** 2 + p * (J - 1)


@pytest.fixture(params=SOLIDS, ids=lambda solid: solid.name)
def solid(request):
    return request.param


@pytest.fixture(params=[1.0, 0.02, -0.01, -0.3], ids=lambda share: f"flattened to {share}")
def F(request):
    """About the identity, all but flat, and inside out, a little and by far."""
    F = np.eye(3) + 0.2 * np.random.default_rng(3).normal(size=(3, 3))
    return np.diag([1.0, request.param, 1.0]) @ F


def test_the_laws_are_found_by_name():
    assert {name: law.name for name, law in LAWS.items()} == {name: name for name in ("neo_hookean", "yeoh")}
    assert {type(solid) for solid in SOLIDS} == set(LAWS.values())


def test_stress_is_the_derivative_of_the_energy(solid, F):
    h = 1e-6
    difference = np.zeros((3, 3))
    for i, j in np.ndindex(3, 3):
        step = np.zeros((3, 3))
        step[i, j] = h
        difference[i, j] = (energy(solid, F + step) - energy(solid, F - step)) / (2 * h)
    np.testing.assert_allclose(stress(solid, F)[0], difference, atol=1e-9)  # h^2 and rounding / h


def test_tangent_is_the_derivative_of_the_stress_with_a_v_shaped_error(solid, F):
    dF, dp = np.random.default_rng(4).normal(size=(3, 3)), 0.8
    exact = stress(solid, F, dF, dp=dp)[1]
    error = {}
    for h in (1e-2, 1e-3, 1e-6, 1e-12):
        forward, back = stress(solid, F + h * dF, p=P + h * dp)[0], stress(solid, F - h * dF, p=P - h * dp)[0]
        error[h] = np.linalg.norm((forward - back) / (2 * h) - exact)
    assert error[1e-2] / error[1e-3] == pytest.approx(100.0, rel=0.2)  # second order
    assert error[1e-6] < 1e-9 * (1.0 + np.abs(exact).max()) < error[1e-12]  # truncation gone; rounding takes over


def test_rest_is_free_of_stress_and_frames_do_not_matter(solid, F):
    assert np.abs(stress(solid, np.eye(3), p=0.0)[0]).max() < 1e-15
    Q, _ = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))
    Q *= np.sign(np.linalg.det(Q))
    np.testing.assert_allclose(stress(solid, Q @ F)[0], Q @ stress(solid, F)[0], atol=1e-14)


def test_cauchy_stress_is_that_of_the_first_piola_stress(solid, F):
    first_piola, _, cauchy = stress(solid, F)
    np.testing.assert_allclose(cauchy, first_piola @ F.T / np.linalg.det(F), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(cauchy, cauchy.T, rtol=1e-12, atol=1e-12)


def test_the_modulus_in_single_precision_gives_increments_and_blocks(solid):
    """In coordinates xi of the element: metric = mu g g^T, and cof is that of dx/dxi."""
    rng = np.random.default_rng(7)
    F, dF = np.eye(3) + 0.2 * rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
    ga, gb = rng.normal(size=(2, 3))
    metric = MU * np.eye(3)
    dP, block, own = tangent(solid, F, dF, ga, gb, metric, dp=0.3)
    np.testing.assert_allclose(dP, stress(solid, F, dF, dp=0.3)[1], rtol=1e-5, atol=1e-5)
    columns = [stress(solid, F, np.outer(axis, gb))[1] @ ga for axis in np.eye(3)]
    np.testing.assert_allclose(block, np.stack(columns, axis=1), rtol=1e-5, atol=1e-5)
    columns = [0.5 * stress(solid, F, np.outer(axis, ga))[1] @ ga for axis in np.eye(3)]
    np.testing.assert_allclose(own, np.stack(columns, axis=1), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(("law", "constants"), [("neo_hookean", {}), ("yeoh", {"c20": 0.1, "c30": 0.3})])
def test_small_strain_limit_is_hooke(law, constants):
    E, nu = 1.0, 0.499
    solid = LAWS[law].from_engineering(E, nu, 2.0, **constants)
    e = 1e-7 * np.random.default_rng(6).normal(size=(3, 3))
    e = e + e.T
    p = (solid.lam - solid.gamma) * np.trace(e)
    mu = E / (2 * (1 + nu))
    hooke = 2 * mu * e + 2 * mu * nu / (1 - 2 * nu) * np.trace(e) * np.eye(3)
    error = np.abs(stress(solid, np.eye(3) + e, p=p)[0] - hooke).max()
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


def test_constants_that_leave_no_bulk_stiffness_are_refused():
    with pytest.raises(ValueError, match=r"'c20': 0\.1.*too large for poisson_ratio = 0\.3"):
        LAWS["yeoh"].from_engineering(1.0, 0.3, 1.0, c20=0.1, c30=0.0)
    with pytest.raises(TypeError):
        LAWS["neo_hookean"].from_engineering(1.0, 0.3, 1.0, c20=0.1)
