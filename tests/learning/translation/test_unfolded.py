"""The skin rolled out flat, of a cylinder, whose arcs are known."""

import numpy as np
import pytest
import trimesh

from simgen.learning.translation.unfolded import FINER, GRID_M, UnfoldedSkin

RADIUS, LENGTH, FACETS = 7.0e-3, 30.0e-3, 64
SAG = RADIUS * (1.0 - np.cos(np.pi / FACETS))  # of a facet, m: 8 um
SHORT = np.pi * RADIUS * (np.pi / FACETS) ** 2 / 6.0  # by which a polygon of chords is shorter than half its circle, m
STEP_MM = 1e3 * GRID_M / FINER  # more than between neighbours of a map


@pytest.fixture(scope="module")
def cylinder() -> tuple[np.ndarray, np.ndarray]:
    """A closed one along x, of rings 1 mm apart."""
    rings = [(RADIUS, height) for height in np.linspace(-LENGTH / 2, LENGTH / 2, 31)]
    mesh = trimesh.creation.revolve([(0.0, -LENGTH / 2), *rings, (0.0, LENGTH / 2)], sections=FACETS)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0.0, 1.0, 0.0]))
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


@pytest.fixture(scope="module")
def skin(cylinder):
    return UnfoldedSkin(*cylinder, np.ones(len(cylinder[0]), bool))


def pixels(skin: UnfoldedSkin) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which pixels of a map show skin, and where their middles lie: arcs and positions along the finger, m."""
    known = np.isfinite(skin.map(np.zeros(skin.vertices)))
    left, right, bottom, top = skin.extent
    rows, columns = known.shape
    arc = left + (np.arange(columns) + 0.5) * (right - left) / columns
    along = top + (np.arange(rows) + 0.5) * (bottom - top) / rows
    return known, *(1e-3 * grid for grid in np.meshgrid(arc, along))


def test_rows_are_positions_along_the_finger(cylinder, skin):
    """A linear field is what it is on flat triangles: exact, but for rounding."""
    known, _, along = pixels(skin)
    found = skin.map(3.0 * cylinder[0][:, 0] + 1.0)
    np.testing.assert_allclose(found[known], 3.0 * along[known] + 1.0, rtol=1e-9)


def test_columns_are_arc_lengths(cylinder, skin):
    """On chords: by their sag off the circle, and shorter than it."""
    known, arc, _ = pixels(skin)
    angle = arc[known] / RADIUS
    tolerance = SHORT + SAG
    np.testing.assert_allclose(skin.map(cylinder[0][:, 1])[known], -RADIUS * np.cos(angle), atol=tolerance)
    np.testing.assert_allclose(skin.map(cylinder[0][:, 2])[known], RADIUS * np.sin(angle), atol=tolerance)


def test_all_of_the_skin_is_on_the_map(skin):
    """Half a turn to each side, end to end, but for what is less than a grid point from where it ends."""
    known, arc, along = pixels(skin)
    assert known[:, np.abs(arc[0]) < np.pi * RADIUS - 2.0 * GRID_M][2:-2].all()
    for found, all_of_it in ((arc, np.pi * RADIUS), (along, LENGTH / 2)):
        assert all_of_it - 2.0 * GRID_M < np.abs(found[known]).max() < all_of_it
    left, right, bottom, top = skin.extent
    assert left < 0.0 < right and top < 0.0 < bottom  # the tip, -x, is above


@pytest.mark.parametrize(("height", "pixels_off"), [(0.0, 0.5), (-1.4e-3, 1.0), (2.0e-3, 1.0)])
def test_points_are_placed_by_angle_and_position(skin, height, pixels_off):
    """At the nearest pixel's middle, along each axis; off the skin perhaps at its neighbour's, if the facet there is a
    sag nearer.
    """
    random = np.random.default_rng(0)
    angle, x = random.uniform(-3.0, 3.0, 200), random.uniform(-0.013, 0.013, 200)
    side = np.stack([np.zeros(200), -np.cos(angle), np.sin(angle)], axis=1)
    placed = skin.place((RADIUS + height) * side + x[:, None] * [1.0, 0.0, 0.0])
    tolerance = pixels_off * STEP_MM + 1e3 * (SHORT + SAG)
    np.testing.assert_allclose(placed, 1e3 * np.stack([angle * RADIUS, x], axis=1), atol=tolerance)


def test_what_is_hidden_is_not_on_the_map(cylinder):
    """One half, +z, is hidden: the map ends half a facet beyond the centre line, and so does what is placed on it."""
    vertices, triangles = cylinder
    skin = UnfoldedSkin(vertices, triangles, vertices[:, 2] <= 1e-9)
    known, arc, _ = pixels(skin)
    assert -1e-3 * STEP_MM < arc[known].max() <= np.pi * RADIUS / FACETS + SAG
    assert arc[known].min() < -np.pi * RADIUS + 2.0 * GRID_M
    expected = RADIUS * np.sin(arc[known] / RADIUS)
    np.testing.assert_allclose(skin.map(vertices[:, 2])[known], expected, atol=SHORT + SAG)
    hidden = np.array([[0.0, -RADIUS * np.cos(0.3), RADIUS * np.sin(0.3)]])
    assert skin.place(hidden)[0, 0] == pytest.approx(1e3 * arc[known].max(), abs=1e-6)


def test_a_value_stays_where_its_vertex_is(cylinder, skin):
    """A field of one vertex colours its own triangles alone."""
    vertices, _ = cylinder
    one = int(np.argmin(np.linalg.norm(vertices - [LENGTH / 2, -RADIUS, 0.0], axis=1)))
    found = skin.map(np.eye(len(vertices))[one])
    known, arc, _ = pixels(skin)
    touched = known & (np.nan_to_num(found) > 0.0)
    width = 2.0 * np.pi * RADIUS / FACETS
    assert touched.any() and np.abs(arc[touched]).max() <= width + SHORT + SAG
