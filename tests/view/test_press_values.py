"""Numbers of a press, against whole arrays."""

import numpy as np
import pytest

from simgen.errors import InputError
from simgen.report.curves import axial_force
from simgen.view.press_values import PressValues


def test_numbers_of_a_press_are_those_of_the_arrays(failing):
    values, press = PressValues(failing), 4
    for sensor in failing.sensors:
        own = values.of(sensor, press)
        assert {"force", "moment", "status", "certificate/residual"} <= own.keys() and "displacement" not in own
        for name, found in own.items():
            np.testing.assert_array_equal(found, failing[f"{sensor}/{name}"][press])
        np.testing.assert_allclose(values.axial_force(sensor, press), axial_force(failing, sensor)[press])
        assert values.touch(sensor, press) == failing[f"{sensor}/touch"][press]


def test_the_axial_force_of_the_stand_in_is_a_newton_a_millimetre(whole):
    np.testing.assert_allclose(PressValues(whole).axial_force("biotac", 5), 1e3 * whole["depth"])


def test_imported_files_state_no_axis(imported):
    assert np.isnan(PressValues(imported).axial_force("digit", 0)).all()


def test_a_press_that_is_not_there_yet_has_no_numbers(unfinished):
    own = PressValues(unfinished).of("digit", 11)
    assert np.isnan(own["force"]).all() and (own["status"] == -1).all()


def test_a_file_that_is_gone_is_named(unfinished):
    (unfinished.path / "digit/moment/c/0/0/0").unlink()
    values = PressValues(unfinished)
    assert np.isfinite(values.of("digit", 2)["moment"]).all()
    with pytest.raises(InputError, match="digit/moment/c/0/0/0: is gone"):
        values.of("digit", 0)
