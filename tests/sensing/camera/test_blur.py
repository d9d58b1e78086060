"""The pyramid of Gaussian kernels agrees with OpenCV's, also as a product of matrices."""

import cv2
import numpy as np
import pytest
import warp as wp

from simgen.config.warp_device import start_warp
from simgen.sensing.camera.blur import AROUND, KERNELS, Blur, Pyramid, blur_matrix, pyramid, scaled_kernels

SINGLE = 2e-6  # of values up to 1: four convolutions of up to 51 numbers in single precision


@pytest.fixture
def maps() -> np.ndarray:
    start_warp()
    return np.random.default_rng(0).random((2, 120, 90)).astype(np.float32)


def by_opencv(image: np.ndarray) -> np.ndarray:
    for size in KERNELS:
        image = cv2.GaussianBlur(image, (size, size), 0)
    return image


def test_kernels_follow_each_other_as_in_opencv(maps):
    expected = np.stack([by_opencv(one) for one in maps])
    np.testing.assert_array_equal(Blur(120, 90, KERNELS)(wp.array(maps, device="cpu")).numpy(), expected)


def test_matrices_do_the_same_with_the_same_borders(maps):
    rows, columns = (blur_matrix(size, KERNELS) for size in (120, 90))
    np.testing.assert_allclose(rows @ maps[0] @ columns.T, by_opencv(maps[0].astype(np.float64)), atol=1e-12)
    blur = Blur(120, 90, KERNELS, "cpu")
    np.testing.assert_allclose(
        blur.by_matrices(wp.array(maps, device="cpu")).numpy(), [by_opencv(one) for one in maps], atol=SINGLE
    )


def as_across(image: np.ndarray) -> np.ndarray:
    """The smoothing of the ACROSS paper: the contact gets its heights back after each of three large kernels."""
    contact, sharp = np.abs(image) > 0.4 * np.abs(image).max(), image
    for size in (401, 201, 101):
        image = np.where(contact, sharp, cv2.GaussianBlur(image, (size, size), 0))
    return by_opencv(image)


@pytest.fixture
def dents() -> np.ndarray:
    """Maps (2, 120, 90): an edge and a bump, one of them downwards."""
    start_warp()
    rows, columns = np.mgrid[:120, :90]
    edge = np.where(columns + 0.3 * rows > 70.0, 0.8, 0.0)
    bump = -1.7 * np.exp(-(((rows - 60.0) / 20.0) ** 2) - ((columns - 30.0) / 10.0) ** 2)
    return np.stack([edge, bump]).astype(np.float32)


@pytest.mark.parametrize("way", ["opencv", "matrices"])
def test_across_leaves_the_contact_and_spreads_what_is_around_it(dents, way):
    blur = Blur(120, 90, KERNELS, "cpu", AROUND)
    smooth = blur if way == "opencv" else blur.by_matrices
    found = smooth(wp.array(dents, device="cpu")).numpy()
    np.testing.assert_allclose(found, [as_across(one) for one in dents], atol=4.0 * SINGLE)
    spread = np.abs(found).sum() / np.abs([by_opencv(one) for one in dents]).sum()
    assert spread > 1.2


def test_names_of_pyramids_are_their_kernels():
    assert pyramid("whole", 480) == Pyramid(whole=(51, 21, 11, 5))
    assert pyramid("across", 480) == Pyramid(whole=(51, 21, 11, 5), around=(401, 201, 101))
    assert pyramid("across", 240).around == (201, 101, 51)
    assert pyramid(None, 480) == Pyramid()


def test_what_is_even_stays_even():
    np.testing.assert_allclose(blur_matrix(33, KERNELS).sum(axis=1), 1.0, atol=1e-14)


def test_no_kernels_change_nothing(maps):
    np.testing.assert_array_equal(Blur(120, 90, ())(wp.array(maps, device="cpu")).numpy(), maps)


def test_kernels_are_a_share_of_the_image():
    assert scaled_kernels(480) == KERNELS
    assert scaled_kernels(240) == (25, 11, 5, 3)
    assert scaled_kernels(48) == (5, 3)
    assert all(size % 2 for size in scaled_kernels(1000))
