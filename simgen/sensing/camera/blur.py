"""Smoothing of height maps by a pyramid of Gaussian kernels, as in Taxim (Si and Yuan, RA-L 2022).

There are two pyramids:

- ``whole`` smooths the whole map, because a mesh's facets are no real edges, not even in the contact.
- ``across`` has the kernels of the ACROSS paper (ICRA 2025; ``kernel_size`` in its published configuration). Three
  large kernels come first. After each of them the contact gets its heights back: all pixels above 0.4 of the largest
  height. The small kernels then smooth the whole map. ACROSS smooths the depth of the gel. simgen smooths the height
  above the gel at rest, so that the dome stays as it is.
"""

from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np
import warp as wp
from scipy.ndimage import convolve1d

wp.set_module_options({"enable_backward": False})

KERNELS = (51, 21, 11, 5)  # px
AROUND = (401, 201, 101)  # px
AT_WIDTH = 480  # px, width of the image that these kernels are for
CONTACT = 0.4  # least height of a contact's pixels, as a share of the sample's largest height


class Pyramid(NamedTuple):
    """Kernels, px: ``around`` come first and leave the contact as it was, ``whole`` smooth the whole map."""

    whole: tuple[int, ...] = ()
    around: tuple[int, ...] = ()


PYRAMIDS = {"whole": Pyramid(KERNELS), "across": Pyramid(KERNELS, AROUND)}
Bands = list[tuple[wp.array, wp.array]]  # band matrices for columns and for rows, see `_band`


@wp.kernel
def _down_kernel(
    image: wp.array3d(dtype=wp.float32),
    weights: wp.array2d(dtype=wp.float32),
    first: wp.array(dtype=wp.int32),
    # outputs
    image_out: wp.array3d(dtype=wp.float32),
):
    """Transposed product of a band matrix with the image."""
    sample, row, column = wp.tid()
    start, total = first[row], wp.float32(0.0)
    for k in range(weights.shape[1]):
        total += weights[row, k] * image[sample, start + k, column]
    image_out[sample, column, row] = total


@wp.kernel
def _largest_kernel(
    height: wp.array3d(dtype=wp.float32),
    # outputs
    largest_out: wp.array(dtype=wp.float32),
):
    """Largest absolute height of each sample."""
    sample, row, column = wp.tid()
    wp.atomic_max(largest_out, sample, wp.abs(height[sample, row, column]))


@wp.kernel
def _restore_kernel(
    height: wp.array3d(dtype=wp.float32),
    largest: wp.array(dtype=wp.float32),
    share: wp.float32,
    # outputs
    smooth_out: wp.array3d(dtype=wp.float32),
):
    """Put the contact's heights back into the smoothed map."""
    sample, row, column = wp.tid()
    own = height[sample, row, column]
    if wp.abs(own) > share * largest[sample]:
        smooth_out[sample, row, column] = own


class Blur:
    """Smooths maps (sample, height, width) by Gaussian kernels of ``sizes``, odd numbers of pixels, one by one.

    Kernels ``around`` come first and leave the contact as it was. A CPU uses OpenCV's filter, a GPU products with band
    matrices for rows and columns.
    """

    def __init__(
        self, height: int, width: int, sizes: tuple[int, ...], device: str = "cpu", around: tuple[int, ...] = ()
    ):
        self.sizes, self.around, self.device, self._shape = sizes, around, device, (height, width)

    def __call__(self, image: wp.array) -> wp.array:
        """Smooth a map; on a CPU in place."""
        if self.device != "cpu":
            return self.by_matrices(image)
        for one in image.numpy():  # a view
            self._by_opencv(one)
        return image

    def _by_opencv(self, image: np.ndarray) -> None:
        """Smooth one map (height, width) in place."""
        contact = np.abs(image) > np.float32(CONTACT) * np.abs(image).max()
        sharp = image[contact]
        for size in self.around:
            cv2.GaussianBlur(image, (size, size), 0, dst=image)
            image[contact] = sharp
        for size in self.sizes:
            cv2.GaussianBlur(image, (size, size), 0, dst=image)

    def by_matrices(self, image: wp.array) -> wp.array:
        """Smooth a map by band matrices, on any device."""
        if self.around:
            sharp, largest = image, wp.zeros(len(image), dtype=wp.float32, device=self.device)
            wp.launch(_largest_kernel, dim=image.shape, inputs=[image], outputs=[largest], device=self.device)
            for bands in self._around:
                image = self._product(bands, image)
                inputs = [sharp, largest, CONTACT]
                wp.launch(_restore_kernel, dim=image.shape, inputs=inputs, outputs=[image], device=self.device)
        return self._product(self._whole, image) if self.sizes else image

    def _product(self, bands: Bands, image: wp.array) -> wp.array:
        for weights, first in bands:
            samples, rows, columns = image.shape
            out = wp.empty((samples, columns, rows), dtype=wp.float32, device=self.device)
            wp.launch(_down_kernel, dim=image.shape, inputs=[image, weights, first], outputs=[out], device=self.device)
            image = out
        return image

    @cached_property
    def _whole(self) -> Bands:
        return self._bands(self.sizes)

    @cached_property
    def _around(self) -> list[Bands]:
        return [self._bands((size,)) for size in self.around]

    def _bands(self, sizes: tuple[int, ...]) -> Bands:
        return [_band(blur_matrix(size, sizes), self.device) for size in self._shape]


def pyramid(blur: str | None, width: int) -> Pyramid:
    """Kernels of one of `PYRAMIDS`, or no kernels for None, scaled to an image of this width."""
    return Pyramid(*(scaled_kernels(width, sizes) for sizes in PYRAMIDS[blur])) if blur else Pyramid()


def scaled_kernels(width: int, sizes: tuple[int, ...] = KERNELS) -> tuple[int, ...]:
    """Kernels scaled to an image of this width: odd numbers of pixels, without kernels of one pixel."""
    scaled = [2 * round((size * width / AT_WIDTH - 1.0) / 2.0) + 1 for size in sizes]
    return tuple(size for size in scaled if size > 1)


def blur_matrix(size: int, kernels: tuple[int, ...]) -> np.ndarray:
    """Matrix (size, size) that applies the kernels to a column, mirrored about its last pixel as in OpenCV."""
    matrix = np.eye(size)
    for kernel in kernels:
        matrix = convolve1d(matrix, cv2.getGaussianKernel(kernel, 0)[:, 0], axis=0, mode="mirror")
    return matrix


def _band(matrix: np.ndarray, device: str) -> tuple[wp.array, wp.array]:
    """Nonzero entries of each row, all rows padded to one length, and the column of the first entry."""
    filled = matrix != 0.0
    first = filled.argmax(axis=1)
    last = matrix.shape[1] - filled[:, ::-1].argmax(axis=1)
    length = int((last - first).max())
    first = np.minimum(first, matrix.shape[1] - length)
    weights = np.take_along_axis(matrix, first[:, None] + np.arange(length), axis=1)
    return wp.array(weights, dtype=wp.float32, device=device), wp.array(first, dtype=wp.int32, device=device)
