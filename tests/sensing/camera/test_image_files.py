"""Image files keep every pixel, with red first."""

import cv2
import numpy as np
import pytest

from simgen.errors import InputError
from simgen.sensing.camera.image_files import png, read_image, write_image


def test_a_written_image_comes_back_bit_for_bit(tmp_path):
    image = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    write_image(tmp_path / "a.png", image)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), image)
    assert (tmp_path / "a.png").read_bytes() == png(image)


def test_red_is_first(tmp_path):
    """OpenCV's own order is blue, green, red."""
    cv2.imwrite(str(tmp_path / "a.png"), np.full((2, 2, 3), [1, 2, 250], np.uint8))
    assert read_image(tmp_path / "a.png")[0, 0].tolist() == [250, 2, 1]


@pytest.mark.parametrize(("content", "says"), [(b"", "not an"), (b"text", "not an"), (None, "cannot be read")])
def test_a_file_that_is_no_image_is_one_line(tmp_path, content, says):
    if content is not None:
        (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(InputError, match=rf"a\.png: {says}"):
        read_image(tmp_path / "a.png")
