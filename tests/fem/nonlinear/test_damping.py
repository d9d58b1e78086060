import numpy as np

from simgen.fem.nonlinear.damping import (
    DECAY,
    INITIAL,
    MAX,
    MAX_ITERATIONS,
    NEGLIGIBLE,
    SHORT_STEP,
    STAGNATION_LIMIT,
    STAGNATION_ONSET,
    TangentDamping,
)

ONE, BOTH = np.array([True, False]), np.ones(2, dtype=bool)


def test_damping_doubles_each_time():
    damping = TangentDamping(2)
    damping.begin(BOTH)
    for times in range(3):
        damping.increase(ONE)
        np.testing.assert_array_equal(damping.eta, [INITIAL * 2.0**times, 0.0])
    np.testing.assert_array_equal(np.stack(damping.limits(6, 25)), [[STAGNATION_LIMIT, 6], [MAX_ITERATIONS, 25]])
    damping.begin(ONE)  # the next increment knows nothing of it
    assert not damping.eta.any() and not damping.used.any()


def adapt(damping, share):
    damping.adapt(BOTH[:1], np.array([share]), np.zeros(1))
    return damping.eta[0]


def test_damping_decays_to_nothing_in_whole_steps_and_short_ones_double_it():
    damping = TangentDamping(1)
    damping.increase(BOTH[:1])
    assert adapt(damping, 1.0) == INITIAL * DECAY
    assert adapt(damping, 0.9 * SHORT_STEP) == 2.0 * INITIAL * DECAY
    assert adapt(damping, 1.1 * SHORT_STEP) == 2.0 * INITIAL * DECAY  # neither short nor whole
    fades = int(np.ceil(np.log(2.0 * INITIAL / NEGLIGIBLE) / -np.log(DECAY)))
    assert [adapt(damping, 1.0) for _ in range(fades + 1)][-1] == 0.0
    damping.eta[:] = MAX
    assert adapt(damping, 0.1) == MAX


def test_an_increment_is_stuck_after_iterations_without_progress_and_has_a_last_damping():
    damping = TangentDamping(2)
    damping.begin(BOTH)
    for k in range(STAGNATION_ONSET):
        stuck = damping.adapt(BOTH, np.ones(2), np.array([k + 1, 0]))
    np.testing.assert_array_equal(stuck, ONE)
    damping.eta[:] = MAX, 0.0
    np.testing.assert_array_equal(damping.can_increase(np.array([0, MAX_ITERATIONS])), [False, False])
    np.testing.assert_array_equal(damping.can_increase(np.zeros(2)), [False, True])
