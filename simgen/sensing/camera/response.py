"""Taxim's table of colours: the change of a pixel's colour by the surface's tilt and the pixel's position.

Each bin of the tilt's size and direction has a second-order polynomial of the position for each colour (Si and Yuan,
Taxim, RA-L 2022, section III). Files are `numpy.savez` of ``bins`` and an array (bins, bins, 6) for each of `CHANNELS`.

The names of the arrays mislead. Taxim reads pictures with OpenCV, which puts blue first. So ``grad_r`` holds blue and
``grad_b`` holds red, as the source of the port on PyPI, taxim 1.4.1, says. simgen's files have the same order, so that
Taxim shows their colours. They state it in ``channels``, and add ``width``, ``height`` and ``source``.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Self
from zipfile import BadZipFile

import numpy as np

from simgen.errors import InputError, shown
from simgen.sensors.pinhole import MOST_PIXELS

CHANNELS = ("grad_r", "grad_g", "grad_b")  # arrays of a file, in the order of a picture's channels
COLOURS = "rgb"  # in the order of `Response.coefficients`
PUBLISHED_ORDER = "bgr"  # colours of `CHANNELS`, in OpenCV's order
FIRST_ORDER = "rgb"  # colours of `CHANNELS` in simgen's first files, which have a ``source`` and no ``channels``
TERMS = 6  # x^2, y^2, xy, x, y, 1
PUBLISHED_SIZE = (640, 480)  # px, width and height of the images of published tables


@dataclass(frozen=True)
class Placement:
    """Transformation from an image to the image of a table. A portrait image is turned clockwise for a landscape table.

    turned : True if it is turned
    scale : pixels of the table's image for a pixel of this image
    height : px, of this image
    """

    turned: bool
    scale: float
    height: int

    @classmethod
    def of(cls, height: int, width: int, table_height: int, table_width: int) -> Self:
        """Place an image of this size (px) in the image of a table."""
        turned = (height > width) != (table_height > table_width)
        return cls(turned, table_width / (height if turned else width), height)

    def position(self, rows: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Position x, y of pixels in the table's image."""
        x, y = (self.height - 1 - rows, columns) if self.turned else (columns, rows)
        return self.scale * x, self.scale * y

    def slope(self, down: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Slopes along the table's x and y, from slopes along rows (down) and columns (right)."""
        return (-down, right) if self.turned else (right, down)


@dataclass(frozen=True)
class Response:
    """A table of colours: the change of an image's colours, 0 to 255, by tilt and position.

    coefficients : (3, bins, bins, 6) by colour; size of the tilt; direction of the tilt; x^2, y^2, xy, x, y, 1
    width, height : px, of the image in which x (to the right) and y (downwards) are measured
    source : the kind of data that the table was fitted to; empty if unknown

    The tilt is the gradient of the height h, which is positive towards the camera. Its size atan |grad h| has bins of
    (pi / 2) / (bins - 1) from 0. Its direction atan2(dh / dy, dh / dx) has bins of 2 pi / (bins - 1) from -pi.
    """

    coefficients: np.ndarray
    width: int = PUBLISHED_SIZE[0]
    height: int = PUBLISHED_SIZE[1]
    source: str = ""

    @property
    def bins(self) -> int:
        return self.coefficients.shape[1]

    @property
    def hash(self) -> str:
        """SHA-256 of coefficients and sizes."""
        size = f"{self.width} {self.height} {self.bins} "
        return hashlib.sha256(size.encode() + np.ascontiguousarray(self.coefficients).tobytes()).hexdigest()

    def from_flat(self) -> np.ndarray:
        """Table (bins + 1, bins - 1, 18) for interpolation, relative to the response to no tilt.

        Rows are tilts of 0, 1/2, 3/2, ... bins. Columns are directions from -pi + 1/2 bin on, all around. The response
        to no tilt is the mean of the first bins over all directions. It is subtracted everywhere, so that flat gel
        keeps the background and almost flat gel is not speckled.
        """
        around = self.coefficients[:, :, :-1]  # the last bin is the direction +pi, which equals -pi
        flat = around[:, :1].mean(axis=2, keepdims=True)
        whole = np.concatenate([np.broadcast_to(flat, around[:, :1].shape), around], axis=1) - flat
        return np.moveaxis(whole, 0, 2).reshape(self.bins + 1, self.bins - 1, 3 * TERMS)

    def change(self, slope_x: np.ndarray, slope_y: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Changes of colour (n, 3) for slopes (n,) at positions (n,), px, of the table's image, as `camera.shading`."""
        table, around = self.from_flat(), self.bins - 1
        size = np.arctan(np.hypot(slope_x, slope_y)) / (0.5 * np.pi) * around
        lower = np.minimum((size + 0.5).astype(int), around)
        along = np.where(lower == 0, 2.0 * size, size + 0.5 - lower)[:, None]
        direction = (np.arctan2(slope_y, slope_x) + np.pi) / (2.0 * np.pi) * around - 0.5
        first = np.floor(direction).astype(int)
        across = (direction - first)[:, None]
        one, other = (
            (1.0 - across) * table[row, first % around] + across * table[row, (first + 1) % around]
            for row in (lower, lower + 1)
        )
        own = ((1.0 - along) * one + along * other).reshape(-1, 3, TERMS)
        return np.einsum("nct,nt->nc", own, np.stack([x * x, y * y, x * y, x, y, np.ones_like(x)], axis=1))

    @classmethod
    def load(cls, file: str | Path) -> Self:
        """Read a file of Taxim or simgen. Raises `InputError` if it is no such table."""
        arrays = _arrays(file)
        missing = [name for name in ("bins", *CHANNELS) if name not in arrays]
        if missing:
            raise InputError(f"{file}: {missing[0]} is missing; a table holds bins, {', '.join(CHANNELS)}")
        bins = _count(file, arrays, "bins", 3, 10_000)
        for name in CHANNELS:
            values, shape = arrays[name], (bins, bins, TERMS)
            if values.shape != shape or values.dtype.kind not in "fiu" or not np.isfinite(values).all():
                raise InputError(f"{file}: {name} {values.shape}: allowed: {shape} finite numbers")
        arrays = dict(zip(("width", "height"), PUBLISHED_SIZE, strict=True)) | arrays
        size = (_count(file, arrays, name, 1, MOST_PIXELS) for name in ("width", "height"))
        coefficients = np.stack([arrays[name] for name in _names(_order(file, arrays))]).astype(np.float64)
        return cls(coefficients, *size, str(arrays.get("source", "")))

    def data(self) -> bytes:
        """Encode the table as a file that `load` and Taxim read."""
        arrays = dict(zip(_names(PUBLISHED_ORDER), self.coefficients.astype(np.float32), strict=True))
        about = {"bins": self.bins, "channels": PUBLISHED_ORDER}
        about |= {"width": self.width, "height": self.height, "source": self.source}
        file = BytesIO()
        np.savez_compressed(file, **about, **arrays)
        return file.getvalue()

    def save(self, file: str | Path) -> None:
        """Write the table to a file. Raises `OSError`."""
        Path(file).write_bytes(self.data())


def _arrays(file: str | Path) -> dict[str, np.ndarray]:
    try:
        with np.load(file, allow_pickle=False) as data:
            return {name: data[name] for name in data.files}
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror or error}") from None
    except (ValueError, EOFError, BadZipFile, AttributeError) as error:  # also for a .npy
        raise InputError(f"{file}: not a file of numpy.savez ({shown(str(error), 100)})") from None


def _order(file: str | Path, arrays: Mapping[str, np.ndarray]) -> str:
    """Colours of the file's `CHANNELS`, one letter each. Raises `InputError` if it states another order."""
    if "channels" not in arrays:
        return FIRST_ORDER if "source" in arrays else PUBLISHED_ORDER
    order = str(arrays["channels"])
    if order not in (PUBLISHED_ORDER, FIRST_ORDER):
        raise InputError(f"{file}: channels {shown(order)!r}: allowed: {PUBLISHED_ORDER}, {FIRST_ORDER}")
    return order


def _names(order: str) -> list[str]:
    """Names of the arrays of red, green and blue if `CHANNELS` have the colours ``order``."""
    return [CHANNELS[order.index(colour)] for colour in COLOURS]


def _count(file: str | Path, arrays: Mapping[str, np.ndarray], name: str, least: int, most: int) -> int:
    value = np.ravel(arrays[name])
    if len(value) != 1 or value.dtype.kind not in "iu" or not least <= value[0] <= most:
        raise InputError(f"{file}: {name} {shown(' '.join(map(str, value)))}: allowed: {least} to {most}")
    return int(value[0])
