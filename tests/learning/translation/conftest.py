"""Networks, their dataset, and the figures of both."""

import pytest

from simgen.learning.translation.picture import ChainPainter
from simgen.learning.translation.presses import TranslatedMeshes
from simgen.sensing.camera.renderer import Look, Renderer

SMALL = Look(height=64, width=48)


@pytest.fixture(scope="session")
def networks(trained):
    """The folder of all networks."""
    return trained.output


@pytest.fixture(scope="session")
def meshes(with_electrodes, networks):
    return TranslatedMeshes(with_electrodes, networks, "ours")


@pytest.fixture(scope="session")
def renderer(with_electrodes):
    return Renderer.of_dataset(with_electrodes, "digit", SMALL)


@pytest.fixture(scope="session")
def painter(with_electrodes, meshes):
    return ChainPainter(with_electrodes, "biotac", "digit", meshes.signals_at_rest)
