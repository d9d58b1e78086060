"""Blocks of many environments: where they lie is nobody's business but theirs."""

import numpy as np
import pytest
import warp as wp

from simgen.fem import blocks
from simgen.fem.batch_arrays import ActiveEnvironments
from simgen.fem.precision import mat33f


@wp.kernel(enable_backward=False)
def number_kernel(blocks_out: blocks.Blocks):
    """Block k of environment e: all e + 100 k, and as much again in the last column."""
    k, env = wp.tid()
    value = wp.float32(env + 100 * k)
    K = mat33f(value, value, value, value, value, value, value, value, value)
    blocks.store_block(blocks_out, k, env, K)
    blocks.add_block(blocks_out, k, env, K * wp.diag(wp.vec3f(0.0, 0.0, 1.0)))


@wp.kernel(enable_backward=False)
def read_kernel(made: blocks.Blocks, sum_out: wp.array2d(dtype=wp.float32)):
    k, env = wp.tid()
    K = blocks.block(made, k, env)
    sum_out[k, env] = K[0, 0] + 10.0 * K[2, 2]


@pytest.mark.parametrize("n_env", [1, 5, 32, 40, 65])
def test_each_environment_has_its_own(n_env):
    made = blocks.zeros(3, n_env, "cpu")
    wp.launch(number_kernel, dim=(3, n_env), inputs=[], outputs=[made], device="cpu")
    for env in range(n_env):
        expected = (env + 100.0 * np.arange(3))[:, None, None] * np.array([[1.0, 1.0, 2.0]] * 3)
        np.testing.assert_array_equal(blocks.of_environment(made, env), expected)
    sums = wp.zeros((3, n_env), dtype=wp.float32, device="cpu")
    wp.launch(read_kernel, dim=(3, n_env), inputs=[made], outputs=[sums], device="cpu")
    np.testing.assert_array_equal(sums.numpy(), 21.0 * (np.arange(n_env) + 100.0 * np.arange(3)[:, None]))


def test_clearing_leaves_those_that_are_not_listed():
    made = blocks.zeros(30, 40, "cpu")  # more rows than one thread clears
    made.fill_(1.0)
    chosen = np.isin(np.arange(40), [0, 31, 32])
    blocks.clear(made, ActiveEnvironments.of(chosen, "cpu"))
    for env in range(40):
        assert (blocks.of_environment(made, env) == (0.0 if chosen[env] else 1.0)).all()


@pytest.mark.parametrize("n_env", [5, 40])
@pytest.mark.parametrize("dtype", [wp.float32, wp.uint16])
def test_blocks_move_to_other_environments(n_env, dtype):
    """Within a tile, and with 40 environments from one tile to another."""
    made = blocks.zeros(2, n_env, "cpu", dtype)
    values = np.random.default_rng(0).integers(0, 1000, made.shape)
    made.assign(values)
    before = [blocks.of_environment(made, env) for env in range(n_env)]
    last = n_env - 1
    blocks.move([made], ActiveEnvironments(n_env, "cpu"), np.array([last, 3]), np.array([0, 2]))
    for env in range(n_env):
        np.testing.assert_array_equal(blocks.of_environment(made, env), before[{0: last, 2: 3}.get(env, env)])
