"""Built shapes in the user's cache: the same as those just built, and built again where they may be out of date."""

import numpy as np
import pytest
import trimesh

from simgen.geometry.curved_tetrahedra import LabelledSurface
from simgen.sensors import sensor_geometry, shape_cache
from simgen.sensors.sensor_geometry import load_geometry
from simgen.sensors.shape_cache import BuiltShape, cached


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The user's cache, empty."""
    monkeypatch.setenv("SIMGEN_CACHE", str(tmp_path))
    return tmp_path / "shapes"


def a_shape(size: float = 1.0, **others) -> BuiltShape:
    box = trimesh.creation.box([size, size, size])
    held = {"back": box.triangles_center[:, 1] > 0.0, "left/right": np.zeros(12, dtype=bool)}
    region = np.arange(12, dtype=np.int8) % 3
    return BuiltShape(**{"plain": box, "true": LabelledSurface(box, region), "held_regions": held,
                         "own_vertices": None, "own_tetrahedra": None, "core": None} | others)  # fmt: skip


def assert_same(found: BuiltShape, wanted: BuiltShape):
    for ours, theirs in ((found.plain, wanted.plain), (found.true.surface, wanted.true.surface)):
        np.testing.assert_array_equal(ours.vertices, theirs.vertices)
        np.testing.assert_array_equal(ours.faces, theirs.faces)
    np.testing.assert_array_equal(found.true.region, wanted.true.region)
    assert list(found.held_regions) == list(wanted.held_regions)
    for name, held in wanted.held_regions.items():
        np.testing.assert_array_equal(found.held_regions[name], held)
    assert (found.core is None) == (wanted.core is None)
    if wanted.core is not None:
        np.testing.assert_array_equal(found.core.vertices, wanted.core.vertices)
    for ours, theirs in ((found.own_vertices, wanted.own_vertices), (found.own_tetrahedra, wanted.own_tetrahedra)):
        assert (ours is None) == (theirs is None)
        if theirs is not None:
            np.testing.assert_array_equal(ours, theirs)


def refuse():
    raise AssertionError("builds a shape that is in the cache")


@pytest.mark.parametrize("others", [
    {},
    {"held_regions": {}},
    {"own_vertices": np.eye(4, 3), "own_tetrahedra": np.arange(4, dtype=np.int32)[None]},
    {"core": trimesh.creation.box([0.1, 0.2, 0.3])},
])  # fmt: skip
def test_a_shape_is_built_once(folder, others):
    wanted = a_shape(**others)
    assert_same(cached("a", lambda: wanted), wanted)
    assert_same(cached("a", refuse), wanted)
    assert [file.name for file in folder.iterdir()] == ["a.npz"]


def test_other_shapes_are_built(folder):
    cached("a", a_shape)
    assert_same(cached("b", lambda: a_shape(2.0)), a_shape(2.0))


def test_a_shape_of_other_code_is_built_again(folder, monkeypatch):
    cached("a", a_shape)
    monkeypatch.setattr(shape_cache, "_builder", lambda: "newer code")
    assert_same(cached("a", lambda: a_shape(2.0)), a_shape(2.0))
    assert_same(cached("a", refuse), a_shape(2.0))


def test_a_broken_file_is_replaced(folder):
    cached("a", a_shape)
    file = folder / "a.npz"
    file.write_bytes(file.read_bytes()[:1000])
    assert_same(cached("a", a_shape), a_shape())
    assert_same(cached("a", refuse), a_shape())


def test_a_cache_that_cannot_be_written_does_no_harm(tmp_path, monkeypatch):
    file = tmp_path / "file"
    file.touch()
    monkeypatch.setenv("SIMGEN_CACHE", str(file))
    assert_same(cached("a", a_shape), a_shape())


@pytest.mark.parametrize("name", ["digit", "biotac"])
def test_bundled_sensors_are_the_same_from_the_cache(folder, monkeypatch, name):
    """To the byte, and with the same derived values."""
    shapes = []
    for build in (sensor_geometry._build, refuse):
        monkeypatch.setattr(sensor_geometry, "_built", {})
        monkeypatch.setattr(sensor_geometry, "_build", build)
        shapes.append(load_geometry(name))
    built, found = shapes
    assert found.source == built.source
    np.testing.assert_array_equal(found.true.surface.vertices, built.true.surface.vertices)
    np.testing.assert_array_equal(found.true.surface.face_normals, built.true.surface.face_normals)
    np.testing.assert_array_equal(found.true.region, built.true.region)
    assert found.held_regions.keys() == built.held_regions.keys()
    assert (found.core is None) == (name == "digit")
    if found.core is not None:
        np.testing.assert_array_equal(found.core.face_normals, built.core.face_normals)


def test_the_builder_depends_on_code_and_packages(monkeypatch):
    before = shape_cache._builder.__wrapped__()
    assert before == shape_cache._builder.__wrapped__()
    monkeypatch.setattr(trimesh, "__version__", "0")
    assert shape_cache._builder.__wrapped__() != before
    monkeypatch.undo()
    monkeypatch.setattr(shape_cache, "BUILDERS", ("geometry",))
    assert shape_cache._builder.__wrapped__() != before
