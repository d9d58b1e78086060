"""Fixtures that several test files share."""

import os
import shutil
import tempfile
from pathlib import Path

import pytest

OWN_CACHE = pytest.StashKey[str]()


def pytest_configure(config):
    """Give all processes of these tests a cache of their own. Workers of pytest-xdist inherit the variable."""
    if not hasattr(config, "workerinput"):
        config.stash[OWN_CACHE] = os.environ["SIMGEN_CACHE"] = tempfile.mkdtemp(prefix="simgen-cache-")


def pytest_unconfigure(config):
    if OWN_CACHE in config.stash:
        shutil.rmtree(config.stash[OWN_CACHE], ignore_errors=True)


@pytest.fixture(scope="session", autouse=True)
def no_flush():
    """Files of tests need not survive a power cut: a flush takes milliseconds, and a dataset has hundreds of files."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda handle: None)
        yield


@pytest.fixture(scope="session")
def reference() -> Path:
    """The published reference data: ``../shared/reference`` beside the checkout, or ``$SIMGEN_REFERENCE``."""
    default = Path(__file__).resolve().parents[2] / "shared" / "reference"
    folder = Path(os.environ.get("SIMGEN_REFERENCE", default))
    if not folder.is_dir():
        pytest.skip(f"no reference data at {folder} (set SIMGEN_REFERENCE)")
    return folder


@pytest.fixture(scope="session")
def with_electrodes(tmp_path_factory):
    """A dataset on which everything can be trained."""
    from tests.learning import touched  # torch, which other tests do not wait for

    return touched.make(tmp_path_factory.mktemp("touched") / "d.zarr")


@pytest.fixture(scope="session")
def trained(with_electrodes, tmp_path_factory):
    """Everything, trained on it: a `simgen.learning.training.run.TrainingRun`."""
    from tests.learning import touched

    return touched.train(touched.job(with_electrodes.path), tmp_path_factory.mktemp("trained") / "networks")
