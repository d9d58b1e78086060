"""Records of increments."""

import numpy as np

from simgen.fem.nonlinear.increment import Increment
from simgen.fem.nonlinear.status import Status


def test_a_record_starts_anew_in_its_own_environments():
    increment = Increment.empty(3)
    for values in vars(increment).values():
        values[:] = 0
    increment.reset(np.array([True, False, True]))
    fresh = Increment.empty(3)
    for name, values in vars(increment).items():
        np.testing.assert_array_equal(values, np.where([True, False, True], getattr(fresh, name), 0))
    assert fresh.status[0] == Status.NEWTON_STALLED and fresh.residual[0] == np.inf
