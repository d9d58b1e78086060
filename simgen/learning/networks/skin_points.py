"""Points of a sensor on the pixel grid of its unrolled skin: features there, and what tells the points apart."""

from typing import Self

import numpy as np
import torch
from scipy.sparse import csr_array
from torch import Tensor, nn

from simgen.learning.networks.skin_grid import PixelGrid, Places
from simgen.learning.networks.sparse import SparseMatrix, product
from simgen.units import MM

WAVES = 4  # sines and cosines of a point's depth
LONGEST_M = 8e-3  # wavelength of the first of these; the next ones are half as long each
NUMBERS = 3 + 2 * WAVES + 4  # of a point, see `SkinPoints.numbers`
BETWEEN = 4  # pixels that a point lies between


class SkinPoints(nn.Module):
    """Points on a grid. The constructor fixes the shapes; `of_places`, or a state, sets the points.

    frames : (point, 3, 3) rows: outward normal, tangent along the finger, tangent along the arc
    numbers : (2, point, NUMBERS) offset from the skin in mm, waves of the depth, place within a pixel; of the points,
        and of their mirror images
    """

    def __init__(self, points: int, pixels: int):
        super().__init__()
        self.to_points = SparseMatrix(points, pixels, BETWEEN * points)
        self.to_pixels = SparseMatrix(pixels, points, BETWEEN * points)
        self.register_buffer("frames", torch.zeros(points, 3, 3))
        self.register_buffer("numbers", torch.zeros(2, points, NUMBERS))

    @classmethod
    def of_places(cls, grid: PixelGrid, places: Places) -> Self:
        points = cls(len(places.x), grid.x.size * grid.arc.size)
        row, column = ((at - axis[0]) / (axis[1] - axis[0]) for at, axis in
                       ((places.x, grid.x), (places.arc, grid.arc)))  # fmt: skip
        matrix = bilinear(row, column, grid.shape)
        points.to_points.fill(matrix)
        points.to_pixels.fill(matrix.T.tocsr())
        points.frames.copy_(torch.from_numpy(places.frames))
        same, mirrored = np.ones(3), np.array([1.0, 1.0, -1.0])
        from_centre = column - 0.5 * (len(grid.arc) - 1)
        for number, turned in enumerate((same, mirrored)):
            values = _numbers(row - 0.5 * (len(grid.x) - 1), turned[2] * from_centre, turned * places.offset)
            points.numbers[number].copy_(torch.from_numpy(values))
        return points

    def __len__(self) -> int:
        return len(self.frames)

    def features(self, images: Tensor) -> Tensor:
        """Features (point, n, channel) at the points, between the pixels of images (n, channel, row, column)."""
        at_pixels = images.flatten(2).permute(2, 0, 1).float().contiguous()
        return product(self.to_points, self.to_pixels, at_pixels.flatten(1)).unflatten(1, at_pixels.shape[1:])


def bilinear(row: np.ndarray, column: np.ndarray, shape: tuple[int, int]) -> csr_array:
    """Bilinear interpolation (point, pixel) at places (point,), counted in pixels; beyond the edge it is constant."""
    starts, parts = [], []
    for at, count in ((row, shape[0]), (column, shape[1])):
        inside = np.clip(at, 0.0, count - 1.0)
        starts.append(np.minimum(inside.astype(np.int64), count - 2))
        parts.append(np.stack([1.0 - (inside - starts[-1]), inside - starts[-1]]))
    pixels = [(starts[0] + i) * shape[1] + starts[1] + j for i in (0, 1) for j in (0, 1)]
    weights = [parts[0][i] * parts[1][j] for i in (0, 1) for j in (0, 1)]
    count = BETWEEN * np.arange(len(row) + 1)
    return csr_array((np.stack(weights, 1).ravel(), np.stack(pixels, 1).ravel(), count), (len(row), np.prod(shape)))


def _numbers(row: np.ndarray, column: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Numbers (point, NUMBERS); row and column are counted from the middle of the grid, offsets are in m."""
    angle = 2.0 * np.pi / LONGEST_M * offset[:, :1] * 2.0 ** np.arange(WAVES)
    within = 2.0 * np.pi * np.stack([column, row], axis=1)
    return np.concatenate([offset / MM, np.sin(angle), np.cos(angle), np.sin(within), np.cos(within)], axis=1)
