"""A dataset's arrays are what they must be; what somebody has changed is named."""

import numpy as np
import pytest
import zarr

from simgen.dataset.layout import checked, faults
from simgen.dataset.reader import Dataset
from simgen.errors import InputError


def changed(dataset: Dataset, name: str, values: np.ndarray) -> Dataset:
    root = zarr.open_group(dataset.path, mode="r+", use_consolidated=False)
    root.create_array(name, data=values, overwrite=True)
    zarr.consolidate_metadata(dataset.path)
    return Dataset(dataset.path)


def test_a_dataset_that_was_just_made_has_no_fault(dataset):
    assert faults(dataset) == {}
    assert checked(dataset) is dataset


@pytest.mark.filterwarnings("ignore:Consolidated metadata")
@pytest.mark.parametrize(("name", "change", "says"), [
    ("press/trajectory", lambda values: values[:-1], "int32 (11,); allowed: integer (12,)"),
    ("press/contact_pose", lambda values: values.astype(np.int32), "int32 (12, 4, 4); allowed: floating (12, 4, 4)"),
    ("press/indenter", lambda values: values + 1, "1 to 3; allowed: 0 to 2"),
    ("biotac/rest_positions", lambda values: values * np.nan, "values that are not finite numbers"),
    ("digit/pose", np.ones_like, "matrices that cannot be inverted"),
])  # fmt: skip
def test_an_array_that_was_changed_is_named(dataset, name, change, says):
    dataset = changed(dataset, name, change(dataset[name]))
    assert faults(dataset) == {name: says}
    with pytest.raises(InputError, match=f"{name}: .*`simgen check` says more"):
        checked(dataset)
