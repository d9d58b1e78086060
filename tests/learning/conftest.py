"""A dataset with a mesh that networks can learn on, made in a second, and the BioTac's model, for all tests here."""

from functools import cache

import fake
import numpy as np
import pytest
import torch
from scipy.spatial import Delaunay

from simgen.learning.data.samples import load_training_data
from simgen.pipeline.run import run
from simgen.sensing.electrodes import gaps as electrode_gaps

THREADS = torch.get_num_threads()


def make_dataset(path, **changes):
    """Twelve trajectories on a ball of 642 vertices, whose tetrahedra fill it."""
    plan = fake.make_plan(fake.make_job(**{"trajectories": {"count": 12}} | changes))
    for sensor in plan.job.sensors:
        plan.arrays[f"{sensor}/tetrahedra"] = Delaunay(fake.VERTICES).simplices.astype(np.int32)
    return run(plan, path, build=fake.failing_presser)


@pytest.fixture(scope="module", autouse=True)
def all_threads():
    """Sums depend on the number of threads, and tests before these may have kept torch to one core."""
    torch.set_num_threads(THREADS)


@pytest.fixture(scope="session")
def learnable(tmp_path_factory):
    return make_dataset(tmp_path_factory.mktemp("training") / "learnable.zarr")


@pytest.fixture(scope="session")
def data(learnable):
    return load_training_data(learnable.path, ("biotac", "digit"), torch.device("cpu"), lambda items, about: items)


@pytest.fixture(scope="session", autouse=True)
def one_model():
    """Read the BioTac's model once, and not for each of a dozen trainings: 2 s each."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(electrode_gaps, "load_geometry", cache(electrode_gaps.load_geometry))
        yield
