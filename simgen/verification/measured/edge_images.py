"""Frames of a real press of an edge, and images of a simulated one: place, colours, and size of the imprint.

Nobody calibrated the colours of the sensor in the frames. So colours are polynomials of the tilt that the press adds,
fitted to some frames; others are compared.
"""

import re
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Self

import cv2
import numpy as np

from simgen.sensing.camera.image_files import read_image

UNTOUCHED = 4  # first frames, whose mean is the image without contact
SMOOTH = 1.0 / 240.0  # standard deviation, in widths of the image, of what smooths noise before sizes are measured
CLEAR = 0.4  # share of the largest change of colour that belongs to the ridge for certain
REACH_MM = (4.0, 7.5)  # half of the window around a ridge in which an imprint is measured: across, along


def read_changes(folder: Path, pattern: str, height: int, width: int) -> np.ndarray:
    """Changes of colour (frame, height, width, 3) float32, levels, against the first frames, fingertip up.

    Frames are landscape, with the fingertip at the right. The median of each frame is subtracted, as its light varies.
    """
    files = sorted(folder.glob(pattern), key=lambda file: int(re.sub(r".*_", "", file.stem)))
    frames = [np.ascontiguousarray(np.rot90(read_image(file))) for file in files]
    small = np.array([cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA) for frame in frames], np.float32)
    change = small - small[:UNTOUCHED].mean(axis=0)
    return change - np.median(change, axis=(1, 2), keepdims=True)


@dataclass(frozen=True)
class EdgeLine:
    """The line of a straight edge in an image: its middle, px, and its direction (column, row) as a unit vector."""

    column: float
    row: float
    direction: tuple[float, float]

    @classmethod
    def of(cls, change: np.ndarray) -> Self:
        """Find the ridge of an imprint from its change of colour (height, width, 3), by its second moments."""
        size = _size(change)
        rows, columns = np.nonzero(size > CLEAR * size.max())
        weights = size[rows, columns]
        points = np.stack([columns, rows], axis=1)
        middle = np.average(points, axis=0, weights=weights)
        _, axes = np.linalg.eigh(np.cov(points.T, aweights=weights))
        along = axes[:, 1] * np.sign(axes[0, 1] or 1.0)
        return cls(*middle.tolist(), tuple(along.tolist()))

    def moved(self, along: float, across: float) -> Self:
        """Move the middle, px."""
        x, y = self.direction
        return type(self)(self.column + along * x - across * y, self.row + along * y + across * x, self.direction)

    def extent(self, change: np.ndarray, pixel_mm: float) -> tuple[float, float]:
        """Width across and length along the ridge, mm, between the places with half of the largest change of colour."""
        x, y = self.direction
        across, along = (np.arange(-reach / pixel_mm, reach / pixel_mm, 0.25) for reach in REACH_MM)
        columns = self.column + along[None] * x - across[:, None] * y
        rows = self.row + along[None] * y + across[:, None] * x
        size = cv2.remap(_size(change), np.float32(columns), np.float32(rows), cv2.INTER_LINEAR)
        middle = np.abs(along) < 0.5 * along.max()
        step = 0.25 * pixel_mm
        return step * _width(size[:, middle].mean(axis=1)), step * _width(size.max(axis=0))


class NormalColours:
    """Colours as polynomials of second order in the unit normal of the dent. Coefficients are linear in the place.

    The dent is the change of the coat since rest; a curved gel's own normal is not counted.

    blur_px : standard deviation of the smoothing of images
    """

    def __init__(self, coefficients: np.ndarray, blur_px: float):
        self.coefficients, self.blur_px = coefficients, blur_px

    @classmethod
    def fit(cls, heights: np.ndarray, pixel_m: np.ndarray, changes: np.ndarray, where: np.ndarray, blur_px: float):
        """Fit to height maps (n, height, width) m and changes of colour (n, height, width, 3), by least squares.

        pixel_m : (height, width) m, size of each pixel; where (height, width): pixels that count
        """
        terms = np.concatenate([cls._terms(height, pixel_m, blur_px)[where] for height in heights])
        return cls(np.linalg.lstsq(terms, changes[:, where].reshape(-1, 3), rcond=None)[0], blur_px)

    def __call__(self, height: np.ndarray, pixel_m: np.ndarray) -> np.ndarray:
        """Change of colour (height, width, 3), levels, of a height map, m."""
        return self._terms(height, pixel_m, self.blur_px) @ self.coefficients

    @staticmethod
    def _terms(height: np.ndarray, pixel_m: np.ndarray, blur_px: float) -> np.ndarray:
        down, right = (np.nan_to_num(each / pixel_m) for each in np.gradient(height))
        steepness = np.sqrt(1.0 + right * right + down * down)
        down, right = np.float32(down / steepness), np.float32(right / steepness)
        y, x = np.mgrid[-1.0 : 1.0 : height.shape[0] * 1j, -1.0 : 1.0 : height.shape[1] * 1j].astype(np.float32)
        normals = (right, down, right * right, right * down, down * down)
        terms = [each * place for each in normals for place in (np.float32(1.0), x, y)]
        smooth = partial(cv2.GaussianBlur, ksize=(0, 0), sigmaX=blur_px)
        return np.stack([smooth(each) if blur_px else each for each in terms], axis=-1)


def shifted(image: np.ndarray, right: float, down: float) -> np.ndarray:
    """Shift an image by some pixels; its border is repeated."""
    moved = np.array([[1.0, 0.0, right], [0.0, 1.0, down]])
    return cv2.warpAffine(image, moved, image.shape[1::-1], flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _size(change: np.ndarray) -> np.ndarray:
    sigma = SMOOTH * min(change.shape[:2])
    return np.linalg.norm(cv2.GaussianBlur(np.float32(change), (0, 0), sigma), axis=2)


def _width(profile: np.ndarray) -> float:
    """Distance, in steps, between the outermost places where a profile crosses half of its largest value."""
    floor = np.median(np.concatenate([profile[: len(profile) // 12], profile[-(len(profile) // 12) :]]))
    level = 0.5 * (floor + profile.max())
    above = np.flatnonzero(profile > level)
    first, last = int(above[0]), int(above[-1])
    begin = first - (profile[first] - level) / (profile[first] - profile[first - 1]) if first else 0.0
    at_end = last == len(profile) - 1
    end = last if at_end else last + (profile[last] - level) / (profile[last] - profile[last + 1])
    return float(end - begin)
