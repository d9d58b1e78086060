"""Bundled sensors; a slab of gel, 20 mm x 4 mm x 20 mm, held at its back; a cache of meshes for these tests alone."""

import pytest
import trimesh

from sensors.slab import SLAB, write_sensor
from simgen.sensors.sensor import load_sensor


@pytest.fixture(scope="package")
def own_cache(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SIMGEN_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="package")
def slab_folder(tmp_path_factory, own_cache):
    folder = write_sensor(tmp_path_factory.mktemp("slab"), SLAB)
    trimesh.creation.box([20.0, 4.0, 20.0]).export(folder / "slab.stl")
    return folder


@pytest.fixture(scope="package")
def slab(slab_folder):
    return load_sensor(slab_folder)


@pytest.fixture(scope="module")
def digit():
    return load_sensor("digit")


@pytest.fixture(scope="module")
def biotac():
    return load_sensor("biotac")
