"""Networks and the dataset that they were trained on, as `training` makes them, and what is drawn of both."""

from functools import cache

import pytest
from training.conftest import one_model, trained, with_electrodes  # noqa: F401  (fixtures)

from simgen.exchange.selection import select
from simgen.optics.renderer import Look, Renderer
from simgen.translate import picture
from simgen.translate.picture import ChainPainter
from simgen.translate.presses import TranslatedMeshes

SMALL = Look(height=64, width=48)


@pytest.fixture(scope="session", autouse=True)
def one_geometry():
    """The BioTac's model is read once for all pictures: 2 s each."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(picture, "load_geometry", cache(picture.load_geometry))
        yield


@pytest.fixture(scope="session")
def networks(trained):  # noqa: F811
    """The folder of all networks."""
    return trained.output


@pytest.fixture(scope="session")
def meshes(with_electrodes, networks):  # noqa: F811
    return TranslatedMeshes(with_electrodes, networks, "ours")


@pytest.fixture(scope="session")
def renderer(with_electrodes):  # noqa: F811
    return Renderer.of_dataset(with_electrodes, "digit", SMALL)


@pytest.fixture(scope="session")
def painter(with_electrodes, meshes):  # noqa: F811
    return ChainPainter(with_electrodes, "biotac", "digit", meshes.signals_at_rest)


@pytest.fixture(scope="session")
def one_trajectory(with_electrodes):  # noqa: F811
    """Three presses, 10 samples: the ring's stall from the third depth on."""
    return select(with_electrodes, ("biotac", "digit"), "3")
