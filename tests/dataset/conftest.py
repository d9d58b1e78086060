"""A dataset whose presses nobody has solved yet."""

import fake
import pytest

from dataset.shards import make


@pytest.fixture
def dataset(tmp_path):
    return make(tmp_path / "d.zarr", fake.make_job())
