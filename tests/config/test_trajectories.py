"""Depths and forces of a job."""

import numpy as np
import pytest

from config.minimal_job import MINIMAL
from simgen.config.job import load_job
from simgen.errors import InputError


def test_depths_are_exact_decimals_in_metres(write):
    np.testing.assert_array_equal(load_job(write(MINIMAL)).depths_m, [1e-4, 2e-4, 3e-4])


@pytest.mark.parametrize("value", ["0", "-1", "2e4", "strong"])
def test_a_force_limit_out_of_range_is_refused(write, value):
    with pytest.raises(InputError, match=r"trajectories\.max_force_n: .*above 0, to 10000 N"):
        load_job(write(MINIMAL), [f"trajectories.max_force_n={value}"])
