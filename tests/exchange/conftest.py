"""A dataset of stand-ins, with samples that are missing on both sensors."""

import fake
import pytest

from simgen.dataset import Dataset
from simgen.run import run


@pytest.fixture(scope="session")
def dataset(tmp_path_factory):
    """Four trajectories, three indenters, four depths; the ring stalls from the third depth on."""
    path = tmp_path_factory.mktemp("exchange") / "fake.zarr"
    run(fake.make_plan(fake.make_job()), path, build=fake.failing_presser)
    return Dataset(path)


@pytest.fixture(scope="session")
def one_sided(tmp_path_factory):
    """As `dataset`, but the ring never touches the first sensor, and reaches every depth on the second."""
    path = tmp_path_factory.mktemp("exchange") / "one_sided.zarr"
    run(fake.make_plan(fake.make_job()), path, build=fake.missing_presser)
    return Dataset(path)
