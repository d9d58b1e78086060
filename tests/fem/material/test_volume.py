"""Functions of the volume ratio: the cofactor, and the logarithm that goes on below J = 0.05."""

import numpy as np
import warp as wp

from simgen.fem.material.volume import LEAST_DIVISOR, LEAST_LOGARITHM, cofactor, divisor, log_curvature, log_slope
from simgen.fem.precision import mat33


@wp.kernel(enable_backward=False)
def volume_kernel(
    F: mat33,
    J: wp.array(dtype=wp.float64),
    cofactor_out: wp.array(dtype=mat33),
    values_out: wp.array(dtype=wp.vec3d),
):
    i = wp.tid()
    cofactor_out[i] = cofactor(F)
    values_out[i] = wp.vec3d(log_slope(J[i]), log_curvature(J[i]), divisor(J[i]))


def evaluate(F, J):
    J = wp.array(J, dtype=wp.float64, device="cpu")
    out = [wp.zeros(len(J), dtype=kind, device="cpu") for kind in (mat33, wp.vec3d)]
    wp.launch(volume_kernel, dim=len(J), inputs=[mat33(F), J], outputs=out, device="cpu")
    return out[0].numpy()[0], out[1].numpy().T


def test_the_cofactor_is_det_times_the_inverse_transposed_and_is_defined_for_flat_ones():
    F = np.random.default_rng(0).normal(size=(3, 3))
    np.testing.assert_allclose(evaluate(F, [1.0])[0], np.linalg.det(F) * np.linalg.inv(F).T, atol=1e-14)
    np.testing.assert_array_equal(evaluate(np.diag([2.0, 3.0, 0.0]), [1.0])[0], np.diag([0.0, 0.0, 6.0]))


def test_the_logarithm_goes_on_smoothly_below_its_least_argument():
    J = np.array([LEAST_LOGARITHM * 0.999, LEAST_LOGARITHM, LEAST_LOGARITHM * 1.001, 2.0, -1.0])
    slope, curvature, _ = evaluate(np.eye(3), J)[1]
    np.testing.assert_allclose(slope[1:4], 1.0 / J[1:4], rtol=1e-14)
    np.testing.assert_allclose(curvature[1:4], -1.0 / J[1:4] ** 2, rtol=1e-14)
    np.testing.assert_allclose(slope[[0, 4]], 1.0 / LEAST_LOGARITHM + curvature[1] * (J[[0, 4]] - LEAST_LOGARITHM))
    assert curvature[0] == curvature[4] == curvature[1]


def test_nothing_is_divided_by_zero():
    divided = evaluate(np.eye(3), [0.5, -0.5, 1e-9, -1e-9])[1][2]
    np.testing.assert_allclose(divided, [0.5, -0.5, LEAST_DIVISOR, -LEAST_DIVISOR])
