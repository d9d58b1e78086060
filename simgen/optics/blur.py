"""Smoothing of height maps by a pyramid of Gaussian kernels, as Taxim has it (Si and Yuan, RA-L 2022).

Taxim keeps the contact as it was, as its gel is no more than a guess outside of it. Here the whole map is smoothed, as
ACROSS does: the contact comes from finite elements, too, and its facets are no edges.
"""

from functools import cached_property

import cv2
import numpy as np
import warp as wp
from scipy.ndimage import convolve1d

wp.set_module_options({"enable_backward": False})

KERNELS = (51, 21, 11, 5)  # px
AT_WIDTH = 480  # px: the image that these kernels are for


@wp.kernel
def _down_kernel(
    image: wp.array3d(dtype=wp.float32),
    weights: wp.array2d(dtype=wp.float32),
    first: wp.array(dtype=wp.int32),
    # outputs
    image_out: wp.array3d(dtype=wp.float32),
):
    """Rows of the image combined by the rows of a band matrix, and the result transposed."""
    sample, row, column = wp.tid()
    start, total = first[row], wp.float32(0.0)
    for k in range(weights.shape[1]):
        total += weights[row, k] * image[sample, start + k, column]
    image_out[sample, column, row] = total


class Blur:
    """Gaussian kernels of ``sizes`` (odd numbers of pixels) one after the other on maps (sample, height, width).

    On a CPU OpenCV's own; on a GPU the product of all of them, which is a band matrix for rows and one for columns.
    """

    def __init__(self, height: int, width: int, sizes: tuple[int, ...], device: str = "cpu"):
        self.sizes, self.device, self._shape = sizes, device, (height, width)

    def __call__(self, image: wp.array) -> wp.array:
        """The map smoothed; on a CPU in its place."""
        if not self.sizes:
            return image
        if self.device == "cpu":
            for one in image.numpy():  # a view
                for size in self.sizes:
                    cv2.GaussianBlur(one, (size, size), 0, dst=one)
            return image
        return self.by_matrices(image)

    def by_matrices(self, image: wp.array) -> wp.array:
        """The same on any device."""
        for weights, first in self._bands:
            samples, rows, columns = image.shape
            out = wp.empty((samples, columns, rows), dtype=wp.float32, device=self.device)
            wp.launch(_down_kernel, dim=image.shape, inputs=[image, weights, first], outputs=[out], device=self.device)
            image = out
        return image

    @cached_property
    def _bands(self) -> list[tuple[wp.array, wp.array]]:
        return [_band(blur_matrix(size, self.sizes), self.device) for size in self._shape]


def scaled_kernels(width: int, sizes: tuple[int, ...] = KERNELS) -> tuple[int, ...]:
    """Kernels for an image of another width: the same share of it, odd numbers, without those of one pixel."""
    scaled = [2 * round((size * width / AT_WIDTH - 1.0) / 2.0) + 1 for size in sizes]
    return tuple(size for size in scaled if size > 1)


def blur_matrix(size: int, kernels: tuple[int, ...]) -> np.ndarray:
    """(size, size): what the kernels do to a column, borders mirrored about their last pixel as in OpenCV."""
    matrix = np.eye(size)
    for kernel in kernels:
        matrix = convolve1d(matrix, cv2.getGaussianKernel(kernel, 0)[:, 0], axis=0, mode="mirror")
    return matrix


def _band(matrix: np.ndarray, device: str) -> tuple[wp.array, wp.array]:
    """The entries that are not 0, row by row from the first column, all rows of one length."""
    filled = matrix != 0.0
    first = filled.argmax(axis=1)
    last = matrix.shape[1] - filled[:, ::-1].argmax(axis=1)
    length = int((last - first).max())
    first = np.minimum(first, matrix.shape[1] - length)
    weights = np.take_along_axis(matrix, first[:, None] + np.arange(length), axis=1)
    return wp.array(weights, dtype=wp.float32, device=device), wp.array(first, dtype=wp.int32, device=device)
