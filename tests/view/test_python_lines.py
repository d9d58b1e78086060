"""The lines run, and load the sample."""

import fake
import numpy as np
import pytest

from simgen.view.drawn_surface import AT_REST
from simgen.view.python_lines import python_lines
from view.conftest import made


def loaded(dataset, press, step):
    lines, found = python_lines(dataset, press, step), {}
    exec(lines, found)
    return lines, found["rest"], found["u"]


def test_a_valid_sample_is_loaded_for_training(failing):
    lines, rest, u = loaded(failing, 4, 1)
    assert "load_dataset" in lines
    for sensor in failing.sensors:
        np.testing.assert_allclose(u[sensor], failing.displacement(sensor, 4, 1), atol=1e-9)
        np.testing.assert_array_equal(rest[sensor], failing[f"{sensor}/rest_positions"])
        assert u[sensor].any()


def test_a_sample_that_training_leaves_out_is_read_from_the_arrays(tmp_path):
    inside_out = made(tmp_path / "d.zarr", fake.ending_presser, trajectories={"count": 1})
    lines, _, u = loaded(inside_out, 2, 1)
    assert "leaves this sample out (status: digit 9, biotac 9" in lines
    np.testing.assert_array_equal(u["digit"], inside_out.displacement("digit", 2, 1))


def test_a_sample_in_no_split_is_read_from_the_arrays(tmp_path):
    held = made(tmp_path / "d.zarr", dataset={"leave_out": "ring_7mm", "presses_per_shard": 2})
    press = int(np.flatnonzero(held["press/split"] == -1)[0])
    lines, _, u = loaded(held, press, 2)
    assert "leaves this sample out" in lines
    np.testing.assert_array_equal(u["biotac"], held.displacement("biotac", press, 2))


def test_a_sample_that_was_not_reached_and_first_touch(failing):
    _, _, u = loaded(failing, 1, 3)
    assert np.isnan(u["digit"]).all()
    lines, rest, u = loaded(failing, 1, AT_REST)
    assert "the gel is at rest" in lines
    for sensor in failing.sensors:
        assert u[sensor].shape == rest[sensor].shape and not u[sensor].any()


def test_a_path_with_quotes_is_one(whole, tmp_path, monkeypatch):
    monkeypatch.setattr(whole, "path", tmp_path / 'it\'s "mine".zarr')
    text = python_lines(whole, 0, AT_REST)
    (line,) = (line for line in text.splitlines() if line.startswith("dataset ="))
    assert eval(line.removeprefix("dataset = Dataset(").removesuffix(")")) == str(whole.path)


@pytest.mark.parametrize("press, step", [(0, 0), (1, 3), (0, AT_REST)])
def test_lines_are_short_enough_to_read(failing, press, step):
    text = python_lines(failing, press, step).replace(str(failing.path), "/data/d.zarr")
    assert max(map(len, text.splitlines())) <= 120
