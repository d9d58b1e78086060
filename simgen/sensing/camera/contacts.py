"""Circles in which spheres touch, found in pictures or read from a file."""

import csv
import math
from pathlib import Path
from statistics import NormalDist

import cv2
import numpy as np

from simgen.errors import InputError, shown
from simgen.sensing.camera.spheres import Circle

SMOOTH_PX = 1.5  # standard deviation: noise of single pixels is no contact
LEAST = 8.0  # grey levels of the largest difference to the background; a camera's noise is below
SHARE = 0.25  # of the largest difference, that a contact's pixels have
BLURRED_PX = SMOOTH_PX * NormalDist().inv_cdf(1.0 - SHARE)  # beyond a step, smoothed, SHARE of it is left
COLUMNS = ("file", "column", "row", "radius")


def find_circle(picture: np.ndarray, background: np.ndarray) -> Circle:
    """The smallest circle around the largest place where two images (height, width, 3) uint8 differ.

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
    """Of a CSV file with `COLUMNS`, pixels; pictures are named from its folder. Raises `InputError`."""
    try:
        with open(file, newline="", encoding="utf-8-sig") as lines:
            reader = csv.DictReader(lines)
            if set(reader.fieldnames or ()) != set(COLUMNS):
                found = shown(",".join(reader.fieldnames or ()))
                raise InputError(f"{file}: first line {found!r}: allowed: {','.join(COLUMNS)}")
            return {(file.parent / (line["file"] or "")).resolve(): _circle(line, f"{file}: line {reader.line_num}")
                    for line in reader}  # fmt: skip
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{file}: not a CSV file ({error})") from None


def _circle(line: dict[str, str | None], where: str) -> Circle:
    numbers = []
    for name in COLUMNS[1:]:
        try:
            numbers.append(float(line[name] or ""))
        except ValueError:
            numbers.append(math.nan)
        if not math.isfinite(numbers[-1]):
            raise InputError(f"{where}: {name} {shown(str(line[name]))!r}: allowed: a number of pixels")
    return Circle(*numbers)
