"""Curves of the stand-in's forces, which are straight lines."""

import fake
import numpy as np
import pytest

from simgen.view.press_curves import press_curves
from simgen.view.press_values import PressValues
from view.conftest import made


def of(curves, sensor, title):
    (found,) = (curve for curve in curves.curves if (curve.sensor, curve.title) == (sensor, title))
    return found


def test_forces_begin_at_first_touch_and_end_where_the_press_does(failing):
    found = press_curves(PressValues(failing), 1)
    assert found.x_label == "depth, mm" and found.titles == ("normal force", "force, x", "force, y", "force, z")
    normal = of(found, "biotac", "normal force")
    np.testing.assert_allclose(normal.x, [0.0, 0.1, 0.2, 0.3, 0.4])
    np.testing.assert_allclose(normal.values, [0.0, 0.1, 0.2, np.nan, np.nan])
    parts = np.stack([of(found, "biotac", f"force, {axis}").values for axis in "xyz"])
    np.testing.assert_allclose(np.linalg.norm(parts, axis=0), normal.values)


def test_along_a_path_the_axis_counts_steps_and_there_is_shear(sliding):
    found = press_curves(PressValues(sliding), 0)
    assert found.x_label == "step of the path" and found.titles[-1] == "shear force"
    shear = of(found, "digit", "shear force")
    np.testing.assert_array_equal(shear.x, range(7))
    np.testing.assert_allclose(shear.values[1:], 1e-3 * np.hypot(10.0, 20.0) * 1e3 * sliding["depth"])


def test_a_fluid_has_its_pressure(tmp_path):
    filled = made(tmp_path / "d.zarr", sensors=fake.FILLED, trajectories={"count": 1})
    found = press_curves(PressValues(filled), 0)
    pressure = of(found, "biotac", "cavity pressure")
    assert pressure.unit == "kPa" and pressure.values[-1] == pytest.approx(0.4)
    assert [curve.sensor for curve in found.curves if curve.title == "cavity pressure"] == ["biotac"]


def test_imported_files_have_depths_and_no_known_axis(imported):
    normal = of(press_curves(PressValues(imported), 0), "digit", "normal force")
    np.testing.assert_allclose(normal.x, [0.0, 0.1, 0.2, 0.3, 0.4])
    assert np.isnan(normal.values[1:]).all()
