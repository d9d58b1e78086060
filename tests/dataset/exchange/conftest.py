"""A dataset of stand-ins, with samples that are missing on both sensors."""

import fake
import numpy as np
import pytest

from simgen.dataset.reader import Dataset
from simgen.pipeline.run import run

FACE = fake.BALL.faces[0]
OPPOSITE = np.argmin(fake.VERTICES @ fake.VERTICES[FACE[0]])
CELLS = np.array([[FACE[0], FACE[2], FACE[1], OPPOSITE]], np.int32)  # of positive volume, as mesh files must have


def make_dataset(path, build, **changes):
    plan = fake.make_plan(fake.make_job(**changes))
    plan.arrays.update({f"{sensor}/tetrahedra": CELLS for sensor in plan.job.sensors})
    run(plan, path, build=build)
    return Dataset(path)


@pytest.fixture(scope="session")
def dataset(tmp_path_factory):
    """Four trajectories, three indenters, four depths; the ring stalls from the third depth on."""
    return make_dataset(tmp_path_factory.mktemp("exchange") / "fake.zarr", fake.failing_presser)


@pytest.fixture(scope="session")
def ending(tmp_path_factory):
    """As `dataset`, but presses end as planned, and the last indenter is inside out at the second depth."""
    return make_dataset(tmp_path_factory.mktemp("exchange") / "ending.zarr", fake.ending_presser)


@pytest.fixture(scope="session")
def one_sided(tmp_path_factory):
    """As `dataset`, but the ring never touches the first sensor, and reaches every depth on the second."""
    return make_dataset(tmp_path_factory.mktemp("exchange") / "one_sided.zarr", fake.missing_presser)


@pytest.fixture
def tetrahedron(tmp_path):
    """A mesh of one cell, 1 cm wide, and its vertices."""
    vertices = 1e-2 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    path = tmp_path / "cell.tet"
    path.write_text("".join("v {} {} {} 0\n".format(*vertex) for vertex in vertices) + "t 0 1 2 3\n")
    return path, vertices
