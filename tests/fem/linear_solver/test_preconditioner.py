"""The block-triangular preconditioner, with multigrid and with factors."""


import numpy as np
import warp as wp

from tests.fem.linear_solver.clamped_block import Block


def test_the_preconditioner_is_linear_and_leaves_what_is_held():
    block = Block(3, 0.499, 0.1)
    rng = np.random.default_rng(0)
    first, second = (np.where(block.fixed, 0.0, rng.normal(size=(block.n, 1))) for _ in range(2))

    def apply(r):
        z = wp.full((block.n, 1), 7.0, dtype=wp.float32, device="cpu")  # what was there before must not matter
        block.preconditioner.apply(wp.array(r, dtype=wp.float32, device="cpu"), z)
        return z.numpy()

    both = apply(first) - 2.0 * apply(second)
    np.testing.assert_allclose(apply(first - 2.0 * second), both, rtol=0, atol=1e-5 * np.abs(both).max())
    assert np.abs(both[block.fixed]).max() == 0.0
    assert np.abs(both[~block.fixed]).min() > 0.0



def test_a_press_that_the_cycle_fails_on_is_factored():
    """Until it is forgotten: the next press begins with the cycle."""
    block = Block(4, 0.499)
    with_cycle = block.iterations()
    assert block.preconditioner.switch_to_factors(np.array([True]))[0]
    block.update()
    with_factor = block.iterations()
    assert 5 < with_factor < with_cycle  # the pressures are preconditioned as before
    block.preconditioner.forget(np.array([True]))
    block.update()
    assert block.iterations() == with_cycle
