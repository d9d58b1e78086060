"""Contact circles of spheres, found in pictures or read from a file."""

import csv
import math
from pathlib import Path
from statistics import NormalDist

import cv2
import numpy as np

from simgen.errors import InputError, shown
from simgen.sensing.camera.spheres import Circle

SMOOTH_PX = 1.5  # standard deviation of the smoothing that removes noise of single pixels
LEAST = 8.0  # grey levels, least difference to the background that is no camera noise
SHARE = 0.25  # least difference of a contact's pixels, as a share of the largest
BLURRED_PX = SMOOTH_PX * NormalDist().inv_cdf(1.0 - SHARE)  # distance from a smoothed step where SHARE of it is left
COLUMNS = ("file", "column", "row", "radius")


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
    """Read a CSV file with `COLUMNS` in pixels; file names are relative to its folder. Raises `InputError`."""
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
