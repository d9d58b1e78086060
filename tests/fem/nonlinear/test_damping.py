import numpy as np

from simgen.fem.nonlinear.damping import FADE, FIRST, ITERATIONS, LEAST, MOST, PATIENCE, SHORT, STUCK, Damping

ONE, BOTH = np.array([True, False]), np.ones(2, dtype=bool)


def test_only_what_gets_stuck_is_damped_and_twice_as_much_each_time():
    damping = Damping(2)
    damping.begin(BOTH)
    for times in range(3):
        damping.raise_(ONE)
        np.testing.assert_array_equal(damping.eta, [FIRST * 2.0**times, 0.0])
    np.testing.assert_array_equal(np.stack(damping.limits(6, 25)), [[PATIENCE, 6], [ITERATIONS, 25]])
    damping.begin(ONE)  # the next increment knows nothing of it
    assert not damping.eta.any() and not damping.used.any()


def follow(damping, share):
    damping.follow(BOTH[:1], np.array([share]), np.zeros(1))
    return damping.eta[0]


def test_whole_steps_let_damping_fade_to_nothing_and_short_ones_double_it():
    damping = Damping(1)
    damping.raise_(BOTH[:1])
    assert follow(damping, 1.0) == FIRST * FADE
    assert follow(damping, 0.9 * SHORT) == 2.0 * FIRST * FADE
    assert follow(damping, 1.1 * SHORT) == 2.0 * FIRST * FADE  # neither short nor whole
    fades = int(np.ceil(np.log(2.0 * FIRST / LEAST) / -np.log(FADE)))
    assert [follow(damping, 1.0) for _ in range(fades + 1)][-1] == 0.0
    damping.eta[:] = MOST
    assert follow(damping, 0.1) == MOST


def test_an_increment_is_stuck_after_iterations_without_progress_and_has_a_last_damping():
    damping = Damping(2)
    damping.begin(BOTH)
    for k in range(STUCK):
        stuck = damping.follow(BOTH, np.ones(2), np.array([k + 1, 0]))
    np.testing.assert_array_equal(stuck, ONE)
    damping.eta[:] = MOST, 0.0
    np.testing.assert_array_equal(damping.can_raise(np.array([0, ITERATIONS])), [False, False])
    np.testing.assert_array_equal(damping.can_raise(np.zeros(2)), [False, True])
