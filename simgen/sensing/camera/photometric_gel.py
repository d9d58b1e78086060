"""Pictures of a gel and of spheres in it under the photometric model, for fitting a table without a real sensor."""

from collections.abc import Iterator

import numpy as np
from scipy.ndimage import binary_erosion
from scipy.stats.qmc import Sobol

from simgen.errors import InputError
from simgen.sensing.camera.photometry import COLOURS, Photometry
from simgen.sensing.camera.spheres import Circle, Patch, sphere_in
from simgen.sensing.camera.table_fit import Observations, observe
from simgen.sensors.pinhole import Pinhole
from simgen.sensors.sensor import Camera

RADIUS_M = 2e-3  # of the spheres
DEEPEST = 0.995  # largest contact circle, relative to the sphere's radius: tilts up to 84 degrees
SPHERES = 2**10


def photometry_of(camera: Camera) -> Photometry:
    """Photometry with a camera's lights. Raises `InputError` unless there are a red, a green and a blue one."""
    if set(camera.lights) != set(COLOURS):
        raise InputError(f"camera: lights {', '.join(camera.lights)}: allowed: {', '.join(COLOURS)}, one each")
    return Photometry(np.array([camera.lights[colour] for colour in COLOURS]))


class PhotometricGel:
    """A gel under a photometric model.

    rest_depth : (height, width) m at rest, infinite beside the gel; smooth, because facets would be visible
    background : (height, width, 3) float, grey levels of the untouched gel; 0 beside the gel
    """

    def __init__(self, rest_depth: np.ndarray, pinhole: Pinhole, photometry: Photometry):
        self.pinhole, self.photometry = pinhole, photometry
        self.rest_depth, self.seen = rest_depth, np.isfinite(rest_depth)
        radiance = self._radiance(np.where(self.seen, self.rest_depth, np.nan))
        self.exposure = photometry.exposure(radiance[self.seen])
        self.background = np.where(self.seen[..., None], photometry.image(radiance, self.exposure), 0.0)
        self.background = np.nan_to_num(self.background)

    def picture(self, depth: np.ndarray) -> np.ndarray:
        """Grey levels (height, width, 3), not rounded, of a coat at ``depth`` (height, width) m; NaN at its rim."""
        return self.photometry.image(self._radiance(depth), self.exposure)

    def of_patch(self, patch: Patch) -> Observations:
        """Observations of a contact's pixels."""
        depth = np.full(self.rest_depth.shape, np.nan)
        depth[patch.rows, patch.columns] = patch.depth
        change = np.full((*depth.shape, 3), np.nan)
        box = tuple(slice(max(each.min() - 1, 0), each.max() + 2) for each in (patch.rows, patch.columns))
        change[box] = self.photometry.image(self._radiance(depth, box), self.exposure) - self.background[box]
        return observe(patch, self.rest_depth, self.pinhole.focal, change)

    def spheres(self, count: int = SPHERES, seed: int = 0) -> Iterator[Patch]:
        """Contacts of all sizes, spread evenly over the gel; none that is smaller than a pixel."""
        height, width = self.rest_depth.shape
        inner = binary_erosion(self.seen, np.ones((3, 3)))
        for u, v, w in Sobol(3, rng=np.random.default_rng(seed)).random(count):
            row, column = int(u * height), int(v * width)
            if inner[row, column]:
                radius = RADIUS_M * self.pinhole.focal / self.rest_depth[row, column]
                share = 0.3 + (DEEPEST - 0.3) * w
                patch = sphere_in(Circle(column, row, share * radius), RADIUS_M, self.rest_depth, self.pinhole)
                if len(patch.rows):
                    yield patch

    def _radiance(self, depth: np.ndarray, box: tuple[slice, slice] = (slice(None), slice(None))) -> np.ndarray:
        """Radiance (..., 3) of the part ``box`` of a coat at ``depth`` (height, width) m."""
        depth = depth[box]
        height, width = self.rest_depth.shape
        rows, columns = np.arange(height)[box[0]], np.arange(width)[box[1]]
        x, y = self.pinhole.across(rows[:, None], columns[None, :])
        view = np.stack([*np.broadcast_arrays(x, y), np.ones(depth.shape)], axis=-1) * depth[..., None]
        down, right = np.gradient(view, axis=(0, 1))
        normal = np.cross(down, right)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        normal *= -np.sign(normal[..., 2:])  # towards the camera
        return self.photometry.radiance(view @ self.pinhole.axes + self.pinhole.position, normal @ self.pinhole.axes)
