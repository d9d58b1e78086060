"""Indenters of a dataset are loaded again, or refused if they have changed."""

import fake
import numpy as np
import pytest
import trimesh

from simgen.dataset.pressed_indenters import first_touch, pressed_indenters
from simgen.dataset.reader import Dataset
from simgen.dataset.writer import create
from simgen.errors import InputError


def test_a_mesh_is_read_in_its_unit(tmp_path):
    """And finds another one, if the unit or the file has changed since."""
    block = trimesh.creation.box([8.0, 4.0, 6.0])
    block.export(tmp_path / "block.stl")
    plan = fake.make_plan(fake.make_job(indenters=[{"file": f"{tmp_path}/block.stl", "unit": "mm"}, "sphere_7mm"]))
    create(tmp_path / "d.zarr", plan.attributes, plan.arrays, plan.job)
    dataset = Dataset(tmp_path / "d.zarr")
    block_read, sphere = pressed_indenters(dataset)
    np.testing.assert_allclose(np.ptp(block_read.extent, axis=0), [8e-3, 4e-3, 6e-3])
    assert dataset.indenters == ("block", "sphere_7mm") == (block_read.name, sphere.name)
    assert dataset.attributes["indenters"]["block"]["unit"] == "mm"
    block.apply_scale(0.5).export(tmp_path / "block.stl")
    with pytest.raises(InputError, match="block: not the indenter that was pressed"):
        pressed_indenters(dataset)


def test_first_touch_is_in_the_frame_of_the_sensor_and_unknown_without_touch_or_pose():
    turned = np.eye(4)
    turned[:3] = [[0, -1, 0, 0.3], [1, 0, 0, 0.0], [0, 0, 1, 0.0]]
    arrays = {
        "press/pose": np.tile(np.eye(4), (3, 1, 1)),
        "digit/touch": np.array([2e-3, np.nan, 2e-3]),
        "digit/pose": np.stack([turned, turned, np.full((4, 4), np.nan)]),
    }
    pose = first_touch(arrays, "digit")
    expected = np.eye(4)
    expected[1, 3] = 2e-3
    np.testing.assert_allclose(turned @ pose[0], expected, atol=1e-15)
    assert np.isnan(pose[1, :3, 3]).any() and np.isnan(pose[2]).all()
