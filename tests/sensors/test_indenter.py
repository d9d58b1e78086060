"""Indenters: published shapes, exact distances and derivatives, sampled shapes, strict tables."""

import hashlib

import numpy as np
import pytest
import trimesh

from simgen.errors import InputError
from simgen.sensors.indenter import (
    Kind,
    indenter_names,
    load_indenter,
    rigid_shape,
    signed_distance,
)
from simgen.verification.validate.published_geometry import tip_distances

NAMES = indenter_names()
PUBLISHED = [name for name in NAMES if name != "texture_14mm"]


@pytest.mark.parametrize("name", PUBLISHED)
def test_tip_matches_published_shape(name, reference):
    """Every vertex of the published tip (3 mm) lies within 0.05 mm, the bound that the project set.

    The published faces are chords between those vertices, up to 0.082 mm under the true surface at a fillet,
    so they are bounded from one side: nowhere outside by more than 0.05 mm, and 0.05 mm on average.
    """
    published = trimesh.load(reference / "indenters" / f"{name.replace('.5', '-5')}.obj", force="mesh")
    shape = load_indenter(name).shape()
    assert np.abs(tip_distances(shape, published)).max() < 0.05
    points = trimesh.sample.sample_surface(published, 50000, seed=1)[0] * 1e3
    distance = signed_distance(shape, points[points[:, 1] > -3.0])[0]
    assert distance.max() < 0.05
    assert np.abs(distance).mean() < 0.05


def test_tip_lies_in_the_tip_plane_and_the_extent_is_that_of_the_mesh():
    for name in NAMES:
        bounds = load_indenter(name).mesh().bounds
        assert bounds[1, 1] == pytest.approx(0.0, abs=1e-12), name
        np.testing.assert_allclose(load_indenter(name).extent, bounds, atol=1e-12, err_msg=name)


def test_a_closed_mesh_is_an_indenter(tmp_path):
    box = trimesh.creation.box(extents=[4.0, 6.0, 4.0]).apply_translation([0.0, -3.0, 0.0])
    box.export(tmp_path / "block.stl")
    (tmp_path / "mine.yaml").write_text("block: {kind: mesh, file: block.stl, unit: mm, spacing_mm: 0.2}\n")
    indenter = load_indenter("block", tmp_path / "mine.yaml")
    np.testing.assert_allclose(indenter.extent * 1e3, [[-2, -6, -2], [2, 0, 2]], atol=1e-6)
    heights = np.array([-0.4, 0.0, 0.1, 0.5, 1.0])
    distance, normal, _ = signed_distance(indenter.shape(), np.column_stack([0 * heights, heights, 0 * heights]))
    np.testing.assert_allclose(distance, heights, atol=1e-3)
    np.testing.assert_allclose(normal, np.tile([0.0, 1.0, 0.0], (5, 1)), atol=1e-2)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a: {kind: sphere, radius_mm: 1, colour: red}", "a: colour: unknown key; allowed: kind, radius_mm"),
        ("a: {kind: sphere}", "a: radius_mm: missing; allowed: above 0 mm"),
        ("a: {kind: sphere, radius_mm: -1}", "a: radius_mm: -1 is not allowed; allowed: above 0 mm"),
        ("a: {kind: pyramid, radius_mm: 1}", "pyramid"),
        ("a: {kind: cube, half_width_mm: 1, fillet_mm: 2}", "a.fillet_mm"),
        ("a: {kind: ring, outer_radius_mm: 1, hole_radius_mm: 2, fillet_mm: 0.1}", "a.hole_radius_mm"),
        ("b: {kind: sphere, radius_mm: 1}", "no indenter 'a'"),
        ("a: {kind: mesh, file: none.stl}", "none.stl"),
        ("a: [", "YAML"),
    ],
)
def test_bad_tables_name_the_key(tmp_path, text, told):
    table = tmp_path / "table.yaml"
    table.write_text(text)
    with pytest.raises(InputError) as error:
        load_indenter("a", table)
    assert told in str(error.value)
    assert str(tmp_path) in str(error.value)
    assert "\n" not in str(error.value)


def test_an_open_mesh_is_refused(tmp_path):
    mesh = trimesh.creation.box(extents=[0.004, 0.004, 0.004])
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    mesh.export(tmp_path / "open.stl")
    with pytest.raises(InputError, match="watertight"):
        load_indenter(tmp_path / "open.stl")


def test_a_mesh_in_the_wrong_unit_is_refused(tmp_path):
    trimesh.creation.box(extents=[4.0, 4.0, 4.0]).export(tmp_path / "block.stl")
    with pytest.raises(InputError, match="unit: mm"):
        load_indenter(tmp_path / "block.stl")


def test_a_mesh_in_mm_is_the_same_shape_as_in_m(tmp_path):
    """Read with its unit; the grid is as fine as asked for, and resolves a pin that the default one rounds."""
    pin = trimesh.creation.icosphere(subdivisions=4, radius=0.2)
    pin.export(tmp_path / "pin.stl")
    pin.copy().apply_scale(1e-3).export(tmp_path / "metres.stl")
    found = load_indenter(tmp_path / "pin.stl", unit="mm", spacing_mm=0.1)
    np.testing.assert_allclose(found.extent, load_indenter(tmp_path / "metres.stl").extent, rtol=1e-6)
    direction = np.random.default_rng(5).normal(size=(500, 3))
    surface = 0.2 * direction / np.linalg.norm(direction, axis=1)[:, None]
    fine, default = (
        np.abs(signed_distance(load_indenter(tmp_path / "pin.stl", unit="mm", **grid).shape(), surface)[0]).max()
        for grid in ({"spacing_mm": 0.1}, {})
    )
    print(fine, default)
    assert fine < 0.15 * default  # half the spacing: about an eighth


def test_a_mesh_is_sampled_once(tmp_path):
    trimesh.creation.icosphere(subdivisions=1, radius=2.0).export(tmp_path / "ball.stl")
    ball = load_indenter(tmp_path / "ball.stl", unit="mm", spacing_mm=0.5)
    assert ball.shape() is ball.shape()
    assert load_indenter(tmp_path / "ball.stl", unit="mm", spacing_mm=0.4).shape() is not ball.shape()


def test_a_mesh_whose_faces_turn_both_ways_is_a_body(tmp_path):
    mesh = trimesh.creation.box([4e-3, 2e-3, 4e-3])
    faces = mesh.faces.copy()
    faces[:4] = faces[:4, ::-1]
    trimesh.Trimesh(mesh.vertices, faces, process=False).export(tmp_path / "pin.obj")
    distance = signed_distance(load_indenter(tmp_path / "pin.obj").shape(), [[0.0, 0.0, 0.0], [0.0, 2.0, 0.0]])[0]
    np.testing.assert_allclose(distance, [-1.0, 1.0], atol=0.05)


def test_analytic_sizes_are_those_of_the_table():
    """A sphere made by hand is the table's sphere: the order of ``size`` is what `Kind` says."""
    point = [[0.3, 0.4, 1.1]]
    by_hand = signed_distance(rigid_shape(Kind.RING, 7.0, 3.5, 1.0), point)[0]
    np.testing.assert_array_equal(by_hand, signed_distance(load_indenter("ring_7mm").shape(), point)[0])


def test_an_indenter_is_known_by_its_sizes_or_its_file(tmp_path):
    assert load_indenter("sphere_7mm").identity() == {"kind": "sphere", "radius_mm": 3.5}
    file = tmp_path / "block.stl"
    trimesh.creation.box([4e-3, 2e-3, 4e-3]).export(file)
    expected = hashlib.sha256(file.read_bytes()).hexdigest()
    assert load_indenter(file).identity() == {
        "kind": "mesh", "unit": "m", "spacing_mm": 0.2, "sha256": expected,
    }  # fmt: skip
