"""The depth map of the DIGIT's untouched gel follows the true surface, without facets, up to the image's edges."""

import numpy as np
import pytest

from simgen.errors import InputError
from simgen.sensing.camera.undeformed_gel import smooth, table_size, undeformed_gel
from simgen.sensors.height_map import HeightMaps, coat
from simgen.sensors.sensor_geometry import load_geometry

WALLS = 70  # px: the gel's upright walls are in the upper corners


@pytest.fixture(scope="module")
def geometry():
    return load_geometry("digit")


@pytest.fixture(scope="module")
def gel(geometry):
    return undeformed_gel(geometry, 320, 240)


@pytest.fixture(scope="module")
def faceted(geometry, gel):
    surface = geometry.true.surface
    vertices, triangles = np.asarray(surface.vertices), np.asarray(surface.faces)
    return HeightMaps(vertices, coat(vertices, triangles, gel.pinhole), gel.pinhole).rest_depth


def test_smoothing_moves_the_surface_by_less_than_its_bulge(gel, faceted):
    """sigma^2 / 2 times the sum of both curvatures: 0.2 mm, and radii of 8 mm and more on the dome, is 5 um."""
    assert np.abs(gel.depth - faceted)[WALLS:].max() < 5e-6


def test_facets_are_gone(gel, faceted):
    """Slopes jump where facets of half a millimetre meet. They change evenly on the smooth surface."""
    bends = [np.abs(np.diff(depth[WALLS:], n=2, axis=1)) for depth in (gel.depth, faceted)]
    assert np.percentile(bends[0], 99) < 0.5 * np.percentile(bends[1], 99)
    uneven = [np.abs(np.diff(bend, axis=1)).max() for bend in bends]
    assert uneven[0] < 0.1 * uneven[1]


def test_the_image_s_own_edges_are_not_seen(gel):
    """The surface continues beyond the edges, so it bends there no more than elsewhere."""
    bend = np.abs(np.diff(gel.depth[WALLS:], n=2, axis=1))
    assert bend[:, [0, 1, -2, -1]].max() <= 1.05 * bend[:, 5:-5].max()


def test_images_of_other_sizes_see_the_same(geometry, gel):
    small = undeformed_gel(geometry, 160, 120)
    four = gel.depth.reshape(160, 2, 120, 2).mean(axis=(1, 3))
    assert np.abs(small.depth - four)[WALLS // 2 :].max() < 1e-6  # facets are not smoothed from the very same places


def test_what_is_not_seen_is_left_out_of_smoothing():
    depth = np.where(np.arange(40) < 20, 0.02, np.inf) * np.ones((30, 1))
    np.testing.assert_allclose(smooth(depth, 3.0)[:, :20], 0.02, atol=1e-15)
    assert np.isinf(smooth(depth, 3.0)[:, 20:]).all()


def test_tables_are_made_of_images_as_large_as_published_ones(gel):
    assert table_size(gel.camera) == (640, 480)


def test_another_aspect_is_one_line(geometry):
    with pytest.raises(InputError) as raised:
        undeformed_gel(geometry, 240, 320)
    assert str(raised.value) == "picture of 320 x 240 pixels: allowed: sides in the ratio of the camera's 240 x 320"


def test_a_sensor_without_a_camera_is_one_line():
    with pytest.raises(InputError, match=r"biotac/sensor\.yaml: no camera; allowed: a sensor with one, as digit"):
        undeformed_gel(load_geometry("biotac"), 64, 48)
