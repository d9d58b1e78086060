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


GIVEN = "trajectories.contacts=[{x_mm: -6, arc_mm: 0}, {x_mm: -8, arc_mm: 1.5, tilt_deg: 5, roll_deg: -20}]"


def test_given_contacts_are_counted(write):
    job = load_job(write(MINIMAL), ["trajectories={count: 2}", GIVEN])
    trajectories = job.trajectories
    assert trajectories.count == 2 and job.presses == 2
    first, second = (contact.model_dump() for contact in trajectories.contacts)
    assert first == {"x_mm": -6.0, "arc_mm": 0.0, "tilt_deg": 0.0, "azimuth_deg": 0.0, "roll_deg": 0.0}
    assert (second["tilt_deg"], second["azimuth_deg"], second["roll_deg"]) == (5.0, 0.0, -20.0)
    alone = load_job(write(MINIMAL), ["trajectories={max_tilt_deg: 5}", GIVEN])
    assert alone.hash == job.hash != load_job(write(MINIMAL)).hash


def test_no_contacts_are_not_in_the_resolved_job(write):
    job = load_job(write(MINIMAL), ["trajectories={count: 2, contacts: []}"])
    assert job.hash == load_job(write(MINIMAL)).hash and "contacts" not in job.resolved()["trajectories"]


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        (["trajectories={count: 3}", GIVEN], r"trajectories\.count: 3, but contacts lists 2; allowed: 2, or no count"),
        (["trajectories={}"], r"trajectories\.count: missing; allowed: a whole number, 1 to 1000000$"),
        (["trajectories={contacts: []}"], r"trajectories\.count: missing"),
        (["trajectories={contacts: [{x_mm: -6}]}"], r"contacts\.0\.arc_mm: missing; allowed: -1000 to 1000 mm$"),
        (["trajectories={contacts: [{x_mm: 0, arc_mm: 0, tilt_deg: 80}]}"],
         r"contacts\.0\.tilt_deg: 80 is not allowed; allowed: 0 to 45 degrees$"),
        (["trajectories={contacts: [{x_mm: 0, arc_mm: 0, yaw: 80}]}"], r"contacts\.0\.yaw: unknown key; allowed: x_mm"),
        (["trajectories={contacts: 3}"], r"contacts: 3 is not allowed; allowed: a list of contacts \{x_mm, arc_mm,"),
    ],
)  # fmt: skip
def test_bad_contacts_are_refused(write, changes, line):
    with pytest.raises(InputError, match=line):
        load_job(write(MINIMAL), changes)
