"""Fit of a table of colours to pictures of contacts whose tilt is known (Taxim, RA-L 2022, section III-B).

Every pixel is an observation of its bin. Few bins have enough observations to determine a polynomial of the position.
So a bin is fitted first with all bins far around it, then with fewer and nearer ones, as far as their observations
suffice.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from simgen.errors import InputError
from simgen.sensing.camera.response import PUBLISHED_SIZE, TERMS, Placement, Response
from simgen.sensing.camera.spheres import Patch

BINS = 125  # as published
REACH = (20.0, 10.0, 5.0, 2.5, 1.2, 0.6)  # bins, standard deviations of the neighbours' weights, from far to near
PRIOR = 10.0  # weight of the last, wider fit, in observations
SEEN, SEEN_FROM = 5.0, 2.5  # a bin with fewer than SEEN observations within a reach of SEEN_FROM is filled in


@dataclass(frozen=True)
class Observations:
    """Pixels (n,): slopes of the height along the table's x and y, positions in it, changes of colour (n, 3)."""

    slope_x: np.ndarray
    slope_y: np.ndarray
    x: np.ndarray
    y: np.ndarray
    change: np.ndarray


def observe(patch: Patch, rest_depth: np.ndarray, focal: float, change: np.ndarray) -> Observations:
    """Observations of a picture inside a contact.

    rest_depth : (height, width) m, of the untouched gel
    change : (height, width, 3), the picture minus the background, grey levels
    """
    height, width = rest_depth.shape
    risen = np.full((height, width), np.nan)
    risen[patch.rows, patch.columns] = rest_depth[patch.rows, patch.columns] - patch.depth
    rows, columns = (np.clip(each, 1, last - 2) for each, last in ((patch.rows, height), (patch.columns, width)))
    pixel = rest_depth[rows, columns] / focal
    down = 0.5 * (risen[rows + 1, columns] - risen[rows - 1, columns]) / pixel
    right = 0.5 * (risen[rows, columns + 1] - risen[rows, columns - 1]) / pixel
    known = np.isfinite(down) & np.isfinite(right)  # neighbours of the rim lie outside
    place = Placement.of(height, width, *PUBLISHED_SIZE[::-1])
    slopes = place.slope(down[known], right[known])
    return Observations(*slopes, *place.position(rows[known], columns[known]), change[rows[known], columns[known]])


def fit_response(pictures: Iterable[Observations], bins: int = BINS, source: str = "") -> Response:
    """Fit a table to pictures by least squares. Raises `InputError` if they hold no observation."""
    width, height = PUBLISHED_SIZE
    terms, products = np.zeros((bins * bins, TERMS, TERMS)), np.zeros((bins * bins, TERMS, 3))
    for seen in pictures:
        x, y = seen.x / width - 0.5, seen.y / height - 0.5  # of order 1, so that the sums are well conditioned
        basis = np.stack([x * x, y * y, x * y, x, y, np.ones_like(x)], axis=1)
        of = _bins(seen, bins)
        order = np.argsort(of, kind="stable")
        own, first = np.unique(of[order], return_index=True)
        basis, change = basis[order], seen.change[order]
        terms[own] += np.add.reduceat(np.einsum("ni,nj->nij", basis, basis), first)
        products[own] += np.add.reduceat(np.einsum("ni,nc->nic", basis, change), first)
    if not terms.any():
        raise InputError("no pixel of any picture lies in a contact; allowed: circles of two pixels and more")
    found = _solve(terms.reshape(bins, bins, TERMS, TERMS), products.reshape(bins, bins, TERMS, 3))
    return Response(np.moveaxis(found @ _to_pixels(width, height).T, 2, 0), width, height, source)


@dataclass(frozen=True)
class TableError:
    """Mean absolute change of colour in pictures, and mean absolute residual of a table, in grey levels."""

    change: float
    residual: float


def table_error(response: Response, pictures: Iterable[Observations]) -> TableError:
    """Compare a table with pictures."""
    sizes = [
        (np.abs(seen.change).sum(), np.abs(seen.change - predicted).sum(), seen.change.size)
        for seen in pictures
        for predicted in [response.change(seen.slope_x, seen.slope_y, seen.x, seen.y)]
    ]
    change, residual, count = np.sum(sizes, axis=0)
    return TableError(change / count, residual / count)


def _bins(seen: Observations, bins: int) -> np.ndarray:
    """Index (n,) of each observation's bin, by size and direction of the tilt."""
    tilt = np.arctan(np.hypot(seen.slope_x, seen.slope_y))
    direction = np.arctan2(seen.slope_y, seen.slope_x) + np.pi
    along = np.minimum((tilt / (0.5 * np.pi) * (bins - 1)).astype(int), bins - 1)
    across = np.minimum((direction / (2.0 * np.pi) * (bins - 1)).astype(int), bins - 2)
    return along * bins + across


def _solve(terms: np.ndarray, products: np.ndarray) -> np.ndarray:
    """Coefficients (bins, bins, 3, 6) from normal equations that bins share with their neighbours."""
    bins, total = len(terms), terms.sum(axis=(0, 1))
    prior = PRIOR * np.diag(np.diag(total) / total[-1, -1])  # scaled to the mean of all pixels' terms
    found, seen = np.zeros((bins, bins - 1, TERMS, 3)), np.zeros((bins, bins - 1), dtype=bool)
    for reach in REACH:
        # Scaled so that a bin's own observations have weight 1. Directions wrap; the last bin equals the first.
        count = max(2.0 * np.pi * reach**2, 1.0)
        modes = ("nearest", "wrap", "nearest", "nearest")
        a, b = (
            count * gaussian_filter(each[:, :-1], (reach, reach, 0.0, 0.0), mode=modes) for each in (terms, products)
        )
        found = np.linalg.solve(a + prior, b + prior @ found)
        if reach >= SEEN_FROM:
            seen = a[..., -1, -1] >= SEEN
    coefficients = np.full((bins, bins, 3, TERMS), np.nan)
    coefficients[:, :-1][seen] = np.swapaxes(found, 2, 3)[seen]
    return _nearest(coefficients)


def _nearest(found: np.ndarray) -> np.ndarray:
    """Fill tilts that no picture shows from the nearest tilt in the same direction."""
    bins = len(found)
    for column in range(bins - 1):
        known = np.flatnonzero(~np.isnan(found[:, column, 0, 0]))
        if len(known):
            nearest = known[np.abs(np.arange(bins)[:, None] - known).argmin(axis=1)]
            found[:, column] = found[nearest, column]
    if np.isnan(found[:, :-1]).any():
        raise InputError("pictures show tilts in some directions alone; allowed: whole circles, several of them")
    found[:, -1] = found[:, 0]
    return found


def _to_pixels(width: int, height: int) -> np.ndarray:
    """Matrix (6, 6) from coefficients of x / width - 1/2 and y / height - 1/2 to coefficients in pixels."""
    a, b = 1.0 / width, 1.0 / height
    return np.array([
        [a * a, 0, 0, 0, 0, 0],
        [0, b * b, 0, 0, 0, 0],
        [0, 0, a * b, 0, 0, 0],
        [-a, 0, -0.5 * a, a, 0, 0],
        [0, -b, -0.5 * b, 0, b, 0],
        [0.25, 0.25, 0.25, -0.5, -0.5, 1],
    ])  # fmt: skip
