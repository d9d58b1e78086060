"""Contact circles of spheres, found in pictures or read from a file."""

from pathlib import Path
from statistics import NormalDist

import cv2
import numpy as np

from simgen.errors import InputError
from simgen.sensing.camera.picture_numbers import read_picture_numbers
from simgen.sensing.camera.spheres import Circle

SMOOTH_PX = 1.5  # standard deviation of the smoothing that removes noise of single pixels
LEAST = 8.0  # grey levels, least difference to the background that is no camera noise
SHARE = 0.25  # least difference of a contact's pixels, as a share of the largest
BLURRED_PX = SMOOTH_PX * NormalDist().inv_cdf(1.0 - SHARE)  # distance from a smoothed step where SHARE of it is left
COLUMNS = ("column", "row", "radius")


def find_circle(picture: np.ndarray, background: np.ndarray) -> Circle:
    """Smallest circle around the largest region where two images (height, width, 3) uint8 differ.

    Raises `InputError` if they differ nowhere.
    """
    difference = cv2.absdiff(picture, background).astype(np.float32)
    difference = cv2.GaussianBlur(difference, (0, 0), SMOOTH_PX).max(axis=2)
    most = float(difference.max())
    if most < LEAST:
        raise InputError(f"no contact: at most {most:.1f} grey levels off the background; allowed: {LEAST:g} and more")
    changed = (difference > SHARE * most).astype(np.uint8)
    contours, _ = cv2.findContours(changed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    (column, row), radius = cv2.minEnclosingCircle(max(contours, key=cv2.contourArea))
    return Circle(column, row, max(radius - BLURRED_PX, 0.5))


def read_circles(file: Path) -> dict[Path, Circle]:
    """Read a CSV file with ``file`` and `COLUMNS` in pixels, see `read_picture_numbers`. Raises `InputError`."""
    return {picture: Circle(*each) for picture, each in read_picture_numbers(file, COLUMNS, "pixels").items()}
