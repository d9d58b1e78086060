"""A dataset with an indenter that is left out, and its card."""

import fake
import pytest

from simgen.pipeline.run import run

JOB = {"trajectories": {"count": 20}, "dataset": {"leave_out": "ring_7mm", "license": "CC-BY-4.0"}}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    path = tmp_path_factory.mktemp("card") / "fake.zarr"
    return run(fake.make_plan(fake.make_job(**JOB)), path, build=fake.failing_presser)
