"""Stored height maps in images of their own and of other sizes."""

import numpy as np
import pytest

from simgen.errors import InputError
from simgen.sensing.camera.stored_heights import StoredHeights, check_height_maps, has_height_maps
from tests.sensing.camera.scenes import pinhole


def bump(height: int, width: int) -> np.ndarray:
    """A smooth height map of 1 mm, by place and not by pixel."""
    y, x = (np.mgrid[:height, :width] + 0.5) / np.array([height, width])[:, None, None]
    return 1e-3 * np.exp(-((x - 0.4) ** 2 + (y - 0.6) ** 2) / 0.02)


def test_maps_of_the_image_s_own_size_stay_as_they_are():
    rest = np.full((64, 48), 0.02)
    rest[:, :5] = np.inf
    heights = StoredHeights(rest, pinhole(64, 48))
    np.testing.assert_array_equal(heights(bump(64, 48)[None]).numpy()[0], np.float32(bump(64, 48)))
    np.testing.assert_array_equal(heights.seen, np.isfinite(rest))
    np.testing.assert_array_equal(heights.rest_depth, rest)


@pytest.mark.parametrize("scale", [0.5, 2])
def test_other_sizes_show_the_same_surface(scale):
    size = int(64 * scale), int(48 * scale)
    heights = StoredHeights(np.full((64, 48), 0.02), pinhole(*size))
    found = heights(bump(64, 48)[None]).numpy()[0]
    assert found.shape == size and heights.seen.all()
    assert np.abs(found - bump(*size)).max() < 1e-5  # 1 %


def test_no_samples_make_no_maps():
    assert StoredHeights(np.ones((64, 48)), pinhole(64, 48))(np.zeros((0, 64, 48))).shape == (0, 64, 48)


def test_a_dataset_without_height_maps_is_one_line(seen):
    assert not has_height_maps(seen, "digit", None) and not has_height_maps(seen, "finger", None)
    with pytest.raises(InputError, match=r"no digit/height_map; allowed: a dataset of a job with outputs: "):
        check_height_maps(seen, "digit", "default", pinhole())


def test_images_of_another_shape_are_refused():
    with pytest.raises(InputError, match="images of 64 x 64 pixels: allowed: sides in the ratio of the stored"):
        StoredHeights(np.full((64, 48), 0.02), pinhole(64, 64))
