"""Built shapes in the user's cache: the same as those just built, and built again where they may be out of date."""

import os
import re
import stat
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import trimesh

from sensors.slab import SLAB, write_sensor
from simgen.geometry.curved_tetrahedra import LabelledSurface
from simgen.sensors import sensor_geometry, shape_cache
from simgen.sensors.sensor_geometry import load_geometry
from simgen.sensors.shape_cache import BuiltShape, cached
from simgen.units import MM


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


def refuse(*given):
    raise AssertionError("builds a shape that is in the cache")


def find(source: str, build, current: bool = True) -> BuiltShape:
    return cached(source, build, lambda: current)


@pytest.mark.parametrize("others", [
    {},
    {"held_regions": {}},
    {"own_vertices": np.eye(4, 3), "own_tetrahedra": np.arange(4, dtype=np.int32)[None]},
    {"core": trimesh.creation.box([0.1, 0.2, 0.3])},
])  # fmt: skip
def test_a_shape_is_built_once(folder, others):
    wanted = a_shape(**others)
    assert_same(find("a", lambda: wanted), wanted)
    assert_same(find("a", refuse), wanted)
    [file] = folder.iterdir()
    assert file.name == "a.npz" and stat.S_IMODE(file.stat().st_mode) == 0o644  # other users may read it


def test_another_source_is_built(folder):
    find("a", a_shape)
    assert_same(find("b", lambda: a_shape(2.0)), a_shape(2.0))


def test_a_shape_of_other_code_is_built_again(folder, monkeypatch):
    find("a", a_shape)
    monkeypatch.setattr(shape_cache, "BUILDER", "newer code")
    assert_same(find("a", lambda: a_shape(2.0)), a_shape(2.0))
    assert_same(find("a", refuse), a_shape(2.0))


def test_a_shape_is_not_cached_if_a_file_has_changed_meanwhile(folder):
    assert_same(find("a", a_shape, current=False), a_shape())
    assert_same(find("a", lambda: a_shape(2.0)), a_shape(2.0))


def without(name: str, file):
    """Take an array out of a cached shape."""
    with np.load(file) as old:
        arrays = {each: old[each] for each in old.files if each != name}
    np.savez(file, **arrays)


@pytest.mark.parametrize("damage", [
    lambda file: file.write_bytes(file.read_bytes()[:1000]),
    lambda file: file.write_bytes(b""),
    lambda file: file.write_text("no shape"),
    lambda file: np.save(file.open("wb"), np.zeros(3)),
    lambda file: without("region", file),
    lambda file: without("core_faces", file),
    lambda file: without("names", file),
])  # fmt: skip
def test_a_broken_file_is_replaced(folder, damage):
    wanted = a_shape(core=trimesh.creation.box([0.1, 0.2, 0.3]))
    find("a", lambda: wanted)
    damage(folder / "a.npz")
    assert_same(find("a", lambda: wanted), wanted)
    assert_same(find("a", refuse), wanted)


def test_a_cache_that_cannot_be_made_does_no_harm(tmp_path, monkeypatch):
    file = tmp_path / "file"
    file.touch()
    monkeypatch.setenv("SIMGEN_CACHE", str(file))
    assert_same(find("a", a_shape), a_shape())


@pytest.mark.parametrize("step", ["numpy.savez", "os.replace"])
def test_a_full_disk_does_no_harm_and_leaves_nothing(folder, monkeypatch, step):
    def fail(*given, **arrays):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(step, fail)
    assert_same(find("a", a_shape), a_shape())
    assert list(folder.iterdir()) == []


def test_files_of_killed_processes_are_removed_after_a_day(folder):
    folder.mkdir()
    for name, age in (("old.tmp", 90_000.0), ("new.tmp", 60.0)):
        (folder / name).touch()
        os.utime(folder / name, (time.time() - age,) * 2)
    find("a", a_shape)
    assert sorted(file.name for file in folder.iterdir()) == ["a.npz", "new.tmp"]


def test_processes_may_cache_the_same_shape_at_the_same_time(folder):
    with ThreadPoolExecutor(8) as pool:
        for found in pool.map(lambda _: find("a", a_shape), range(40)):
            assert_same(found, a_shape())
    assert [file.name for file in folder.iterdir()] == ["a.npz"]


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


def test_changed_files_and_sizes_are_other_shapes(folder, tmp_path, monkeypatch):
    """Also in a new process, and if a file keeps its time stamp."""
    monkeypatch.setattr(sensor_geometry, "_built", {})
    slab = write_sensor(tmp_path / "slab", SLAB)
    box, stamp = slab / "slab.stl", None
    widths = []
    for width in (20.0, 10.0, 20.0):
        trimesh.creation.box([width, 4.0, 20.0]).export(box)
        stamp = stamp or box.stat().st_mtime_ns
        os.utime(box, ns=(stamp, stamp))
        sensor_geometry._built.clear()
        widths.append(load_geometry(slab).plain.extents[0] / MM)
    np.testing.assert_allclose(widths, [20.0, 10.0, 20.0])
    assert len(list(folder.iterdir())) == 2
    text = (slab / "sensor.yaml").read_text()
    finer = re.sub(r"edge_length_mm: [0-9.]+", "edge_length_mm: 0.9", text, count=1)
    assert finer != text
    (slab / "sensor.yaml").write_text(finer)
    load_geometry(slab)
    assert len(list(folder.iterdir())) == 3


def test_the_builder_depends_on_code_and_packages(monkeypatch):
    assert shape_cache._builder() == shape_cache.BUILDER
    monkeypatch.setattr(trimesh, "__version__", "0")
    assert shape_cache._builder() != shape_cache.BUILDER
    monkeypatch.undo()
    monkeypatch.setattr(shape_cache, "BUILDERS", ("geometry",))
    assert shape_cache._builder() != shape_cache.BUILDER
