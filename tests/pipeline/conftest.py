"""A cluster of two processes."""

import pytest
from dask.distributed import Client

from simgen.pipeline.local_cluster import local_cluster


@pytest.fixture(scope="module")
def client():
    with local_cluster([{}, {}]) as cluster, Client(cluster) as client:
        client.wait_for_workers(2)
        yield client
