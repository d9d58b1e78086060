"""A dataset with a ball that the DIGIT's camera sees, and images of it."""

import fake
import pytest

from simgen.dataset.exchange.selection import select
from simgen.pipeline.run import run
from simgen.sensing.camera.images import Images, render
from simgen.sensing.camera.photometric_gel import PhotometricGel, photometry_of
from simgen.sensing.camera.renderer import Renderer
from simgen.sensing.camera.undeformed_gel import undeformed_gel
from simgen.sensors.sensor_geometry import load_geometry
from tests.sensing.camera.scenes import SMALL


@pytest.fixture(scope="session")
def seen(tmp_path_factory):
    """Four contacts on a ball of 7 mm, three indenters, four depths."""
    return run(fake.make_plan(fake.make_job()), tmp_path_factory.mktemp("seen") / "seen.zarr", build=fake.fake_presser)


@pytest.fixture(scope="session")
def digit() -> PhotometricGel:
    """The DIGIT's gel under the photometric model, in images of the camera's own size."""
    gel = undeformed_gel(load_geometry("digit"), 320, 240)
    return PhotometricGel(gel.depth, gel.pinhole, photometry_of(gel.camera))


@pytest.fixture(scope="session")
def images(seen, tmp_path_factory):
    return Images(seen.path, "digit", tmp_path_factory.mktemp("images") / "seen.images", SMALL)


@pytest.fixture(scope="session")
def chosen(seen):
    return select(seen, ("digit",))


@pytest.fixture(scope="session")
def renderer(seen):
    return Renderer.of_dataset(seen, "digit", SMALL)


@pytest.fixture(scope="session")
def made(images, chosen, renderer) -> list[int]:
    """Numbers of images of each press, all made in the folder of `images`."""
    return list(render(images, chosen, renderer, workers=1))
