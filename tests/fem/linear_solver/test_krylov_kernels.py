"""Kernels that choose the systems that go on."""

import pytest
import warp as wp

from simgen.fem.linear_solver.krylov_kernels import STRICT_ITERATIONS, check_convergence_kernel, compact_kernel


def ints(*values):
    return wp.array(values, dtype=wp.int32, device="cpu")


def test_a_list_is_compacted_in_order_and_counts_iterations():
    active, kept, count, unfinished = ints(4, 2, 7, -1), ints(9, 9, 9, 9), ints(0), ints(9)
    cases = (((1, 0, 1, 1), [4, 7, -1, -1], 1), ((1, 1, 1, 0), [4, 2, 7, -1], 0), ((0, 0, 0, 0), [-1] * 4, 0))
    for keep, left, more in cases:
        inputs, outputs = [ints(*keep), active, 1], [kept, count, unfinished]
        wp.launch(compact_kernel, dim=4, inputs=inputs, outputs=outputs, device="cpu")
        assert kept.numpy().tolist() == left and unfinished.numpy()[0] == more
    assert count.numpy()[0] == 3


@pytest.mark.parametrize(("iteration", "together", "keep"), [(1, 0, 0), (1, 2, 1), (2, 2, 0), (3, 4, 1)])
def test_solved_systems_go_on_in_the_first_iterations_of_a_round(iteration, together, keep):
    square, kept = wp.array([0.01**2], dtype=wp.float64, device="cpu"), ints(9)
    last = wp.array([0.5], dtype=wp.float64, device="cpu")
    inputs = [square, 0.1, 0.3, 10, ints(iteration), together, ints(0)]
    wp.launch(check_convergence_kernel, dim=1, inputs=inputs, outputs=[ints(0), ints(9), last, kept], device="cpu")
    assert kept.numpy()[0] == keep


@pytest.mark.parametrize(
    ("count", "relative", "keep"),
    [(0, 0.2, 1), (0, 0.05, 0), (STRICT_ITERATIONS - 2, 0.2, 1), (STRICT_ITERATIONS - 1, 0.2, 0), (9, 0.5, 0)],
)
def test_the_tolerance_is_looser_from_the_strict_iterations_on(count, relative, keep):
    """Tolerances are 0.1 and 0.3, and there is room for ten iterations."""
    square, kept = wp.array([relative**2], dtype=wp.float64, device="cpu"), ints(9)
    counts, stagnated, last = ints(count), ints(9), wp.array([0.51], dtype=wp.float64, device="cpu")
    inputs, outputs = [square, 0.1, 0.3, 10, ints(1), 0, ints(0)], [counts, stagnated, last, kept]
    wp.launch(check_convergence_kernel, dim=1, inputs=inputs, outputs=outputs, device="cpu")
    assert kept.numpy()[0] == keep and counts.numpy()[0] == count + 1
    assert last.numpy()[0] == pytest.approx(relative) and stagnated.numpy()[0] == (relative > 0.9 * 0.51)
