"""Datasets and networks that the commands are run on."""

from functools import cache

import fake
import pytest
from dataset.exchange.conftest import make_dataset

from simgen.pipeline.run import run
from simgen.sensing.electrodes import gaps as electrode_gaps


@pytest.fixture(scope="session")
def fake_dataset(tmp_path_factory):
    """Four trajectories, three indenters, four depths on a ball of 7 mm; all samples converge."""
    return run(fake.make_plan(fake.make_job()), tmp_path_factory.mktemp("cli") / "d.zarr", build=fake.fake_presser)


@pytest.fixture(scope="session")
def stalled_dataset(tmp_path_factory):
    """The same, but the ring stalls from the third depth on."""
    return make_dataset(tmp_path_factory.mktemp("cli") / "fake.zarr", fake.failing_presser)


@pytest.fixture(scope="session")
def networks(trained):
    """Folder of all networks. The BioTac's model is read once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(electrode_gaps, "load_geometry", cache(electrode_gaps.load_geometry))
        yield trained.output
