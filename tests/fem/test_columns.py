"""Native loads, stores and sums of rows: the same numbers as with Warp's indices, in both precisions."""

import numpy as np
import pytest
import warp as wp

from simgen.fem.columns import add_vector, number_at, store_vector, vector_at
from simgen.fem.precision import real, single


@wp.kernel(enable_backward=False)
def single_kernel(
    x: wp.array2d(dtype=wp.float32),
    # outputs
    stored_out: wp.array2d(dtype=wp.float32), first_out: wp.array2d(dtype=wp.float32),
):  # fmt: skip
    node, env = wp.tid()
    v = vector_at(x, 3 * node, env)
    store_vector(stored_out, 3 * node, env, v)
    add_vector(stored_out, 3 * node, env, single(2.0) * v)
    first_out[node, env] = number_at(x, 3 * node, env)


@wp.kernel(enable_backward=False)
def double_kernel(x: wp.array2d(dtype=wp.float64), sum_out: wp.array2d(dtype=wp.float64)):
    node, env = wp.tid()
    add_vector(sum_out, 3 * node, env, real(3.0) * vector_at(x, 3 * node, env))


@pytest.mark.parametrize("n_env", [1, 4])
def test_rows_of_single_precision(n_env):
    x = np.random.default_rng(0).integers(-50, 50, (9, n_env)).astype(np.float32)
    stored = wp.full((9, n_env), 7.0, dtype=wp.float32, device="cpu")
    first = wp.zeros((3, n_env), dtype=wp.float32, device="cpu")
    inputs = [wp.array(x, dtype=wp.float32, device="cpu")]
    wp.launch(single_kernel, dim=(3, n_env), inputs=inputs, outputs=[stored, first], device="cpu")
    np.testing.assert_array_equal(stored.numpy(), 3.0 * x)
    np.testing.assert_array_equal(first.numpy(), x[::3])


def test_rows_of_a_part_in_double_precision():
    x = np.random.default_rng(1).normal(size=(12, 3))
    whole = wp.array(x, dtype=wp.float64, device="cpu")
    total = wp.ones((9, 3), dtype=wp.float64, device="cpu")
    wp.launch(double_kernel, dim=(3, 3), inputs=[whole[3:]], outputs=[total], device="cpu")
    np.testing.assert_array_equal(total.numpy(), 1.0 + 3.0 * x[3:])
