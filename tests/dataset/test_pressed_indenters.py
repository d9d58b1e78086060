"""Indenters of a dataset are loaded again, or refused if they have changed."""

import fake
import numpy as np
import pytest
import trimesh

from simgen.dataset.pressed_indenters import pressed_indenters
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
