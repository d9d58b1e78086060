"""The imprint of a contact in a picture: where colours differ from those of the untouched gel."""

import cv2
import numpy as np

from simgen.errors import InputError
from simgen.sensing.camera.spheres import Circle

AT_WIDTH = 480.0  # px, width of the image that the lengths below are for
SMOOTH, CLOSED = 3.0, 31.0  # px: standard deviation of the smoothing; width of the gaps that are closed
SHARE = 0.35  # least change of an imprint's pixels, as a share of the largest
LEAST = 16.0  # grey levels; untouched gel of a real DIGIT changes by up to 12 after the smoothing


def find_imprint(change: np.ndarray) -> Circle:
    """Centre and radius, px, of an imprint, from changes of colour (height, width, 3), grey levels.

    The imprint is the largest region where a channel changes by `SHARE` of the most. Its middle is flat and changes
    little, and one side may be hardly lit. So gaps are closed and the convex hull counts. The circle has the hull's
    centroid and area. Raises `InputError` if colours change nowhere.
    """
    scale = min(change.shape[:2]) / AT_WIDTH
    size = cv2.GaussianBlur(np.abs(change).max(axis=2).astype(np.float32), (0, 0), SMOOTH * scale)
    if size.max() < LEAST:
        raise InputError(f"no contact: colours change by at most {size.max():.1f} levels; allowed: {LEAST:g} and more")
    _, number, found, _ = cv2.connectedComponentsWithStats((size > SHARE * size.max()).astype(np.uint8))
    region = (number == 1 + found[1:, cv2.CC_STAT_AREA].argmax()).astype(np.uint8)
    width = 2 * round(0.5 * CLOSED * scale) + 1
    region = cv2.morphologyEx(region, cv2.MORPH_CLOSE, np.ones((width, width), np.uint8))
    outlines, _ = cv2.findContours(region, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    hull = cv2.moments(cv2.convexHull(max(outlines, key=cv2.contourArea)))
    area = hull["m00"]
    if area == 0.0:
        raise InputError("no contact: colours change in a line alone; allowed: a region")
    return Circle(hull["m10"] / area, hull["m01"] / area, float(np.sqrt(area / np.pi)))
