"""Datasets of the stand-in in which presses fail."""

import fake
import pytest

from simgen.dataset.reader import Dataset
from simgen.pipeline.run import run


def made(folder, build) -> Dataset:
    return run(fake.make_plan(fake.make_job()), folder / "d.zarr", build=build)


@pytest.fixture(scope="session")
def failing(tmp_path_factory):
    """The ring stalls from the third of four depths on."""
    return made(tmp_path_factory.mktemp("failing"), fake.failing_presser)


@pytest.fixture(scope="session")
def missing(tmp_path_factory):
    """The ring never touches the digit."""
    return made(tmp_path_factory.mktemp("missing"), fake.missing_presser)
