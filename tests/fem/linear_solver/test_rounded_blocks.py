"""Rounded blocks: their error, numbers beyond the range, inverses with fixed rows."""

import numpy as np
import warp as wp

from simgen.fem import blocks
from simgen.fem.batch_arrays import ActiveEnvironments
from simgen.fem.linear_solver import rounded_blocks

BFLOAT16 = 2.0**-8  # half of the distance of neighbouring numbers, relative


def exact(values: np.ndarray) -> wp.array:
    """Blocks (env, k, 3, 3) on the device, for fewer environments than a tile has."""
    rows = np.moveaxis(values.reshape(len(values), -1), 0, -1)[None]
    return wp.array(np.ascontiguousarray(rows), dtype=wp.float32, device="cpu")


def test_rounding_keeps_eight_digits_and_the_range():
    rng = np.random.default_rng(0)
    values = (rng.normal(size=(3, 4, 3, 3)) * 10.0 ** rng.uniform(-30.0, 30.0, (3, 4, 3, 3))).astype(np.float32)
    values[0, 0, 0] = np.inf, -np.inf, np.nan
    made = rounded_blocks.zeros(4, 3, "cpu")
    active = ActiveEnvironments.of(np.array([True, False, True]), "cpu")
    rounded_blocks.round_blocks(exact(values), 4, active, made)
    for env in (0, 2):
        found = rounded_blocks.of_environment(made, env)
        np.testing.assert_allclose(found, values[env], rtol=BFLOAT16)
        finite = np.isfinite(values[env])
        assert (found[finite] != values[env][finite]).any()
    assert not rounded_blocks.of_environment(made, 1).any()


def test_inverses_have_zeros_in_fixed_rows():
    rng, n = np.random.default_rng(1), 4
    halves = rng.normal(size=(1, n + 1, 3, 3))
    values = halves @ np.swapaxes(halves, 2, 3) + np.eye(3)
    fixed = np.zeros(3 * n, dtype=np.int32)
    fixed[[3, 4, 5, 7]] = 1  # all of node 1, one component of node 2
    diagonal = np.array([1, 0, 4, 2])  # block of each node
    indices = [wp.array(each, dtype=wp.int32, device="cpu") for each in (diagonal, fixed)]
    inverse, active = rounded_blocks.zeros(n, 1, "cpu"), ActiveEnvironments(1, "cpu")
    inputs = [exact(values), *indices, active.numbers]
    wp.launch(rounded_blocks.invert_kernel, dim=(n, 1), inputs=inputs, outputs=[inverse], device="cpu")
    for node, found in enumerate(rounded_blocks.of_environment(inverse, 0)):
        free = np.flatnonzero(fixed[3 * node : 3 * node + 3] == 0)
        expected = np.zeros((3, 3))
        expected[np.ix_(free, free)] = np.linalg.inv(values[0, diagonal[node]][np.ix_(free, free)])
        np.testing.assert_allclose(found, expected, rtol=1.01 * BFLOAT16)


def test_rounded_blocks_lie_like_exact_ones():
    values = np.arange(2.0 * 5 * 9).reshape(2, 5, 3, 3)  # up to 89: bfloat16 holds them exactly
    made = rounded_blocks.zeros(5, 2, "cpu")
    rounded_blocks.round_blocks(exact(values), 5, ActiveEnvironments(2, "cpu"), made)
    for env in range(2):
        np.testing.assert_array_equal(blocks.of_environment(exact(values), env), values[env])
        np.testing.assert_array_equal(rounded_blocks.of_environment(made, env), values[env])
