"""Height maps of the solution that a run has stored, for images of any size."""

import cv2
import numpy as np
import warp as wp

from simgen.config.warp_device import start_warp
from simgen.dataset.reader import Dataset
from simgen.dataset.stored_arrays import REST_DEPTH
from simgen.errors import InputError, shown
from simgen.sensors.pinhole import Pinhole


class StoredHeights:
    """Height maps of a dataset, in the place of `HeightMaps` of a mesh.

    rest_depth : (row, column) m, as stored; infinite for pixels that do not see the gel
    pinhole : the camera of the images; another size than that of the stored maps is interpolated

    Raises `InputError` if the sides of the images have another ratio.
    """

    def __init__(self, rest_depth: np.ndarray, pinhole: Pinhole, device: str = "cpu"):
        rows, columns = rest_depth.shape
        if abs(pinhole.height * columns / (pinhole.width * rows) - 1.0) > 0.01:
            raise InputError(f"images of {pinhole.width} x {pinhole.height} pixels: allowed: sides in the ratio of the "
                             f"stored height maps, {columns} x {rows}, or --heights mesh")  # fmt: skip
        start_warp()
        self.pinhole, self.device = pinhole, device
        self.seen = _resized(np.isfinite(rest_depth).astype(np.float32), pinhole) > 0.5
        known = np.where(np.isfinite(rest_depth), rest_depth, rest_depth[np.isfinite(rest_depth)].max(initial=0.0))
        self.rest_depth = np.where(self.seen, _resized(known, pinhole), np.inf)

    def __call__(self, height: np.ndarray) -> wp.array:
        """Height maps (sample, height, width) float32, m, from stored ones (sample, row, column), m."""
        maps = [_resized(np.asarray(each, np.float32), self.pinhole) for each in height]
        shape = (0, self.pinhole.height, self.pinhole.width)
        return wp.array(np.stack(maps) if maps else np.zeros(shape), dtype=wp.float32, device=self.device)


def check_height_maps(dataset: Dataset, sensor: str, camera: str, pinhole: Pinhole) -> None:
    """Raise `InputError` if a dataset has no height maps of this camera, or the camera has been changed since."""
    if f"{sensor}/{REST_DEPTH}" not in dataset.root:
        raise InputError(f"{dataset.path}: no {sensor}/height_map; allowed: a dataset of a job with outputs: "
                         f"{{{sensor}: [height_map]}}, or --heights mesh")  # fmt: skip
    own = dataset.job.sensors[sensor].camera
    if camera != own:
        raise InputError(f"--camera {shown(camera)}: {dataset.path}/{sensor}/height_map is of camera {own}; allowed: "
                         f"{own}, or --heights mesh")  # fmt: skip
    if dataset.attributes["sensors"][sensor]["camera"] != pinhole.record():
        raise InputError(f"{dataset.path}/{sensor}/height_map: the sensor.yaml has another camera than at the run; "
                         "allowed: the same one, or --heights mesh")  # fmt: skip


def has_height_maps(dataset: Dataset, sensor: str, camera: str | None) -> bool:
    """True if a dataset has height maps of this camera; None stands for the job's."""
    if sensor not in dataset.sensors or f"{sensor}/{REST_DEPTH}" not in dataset.root:
        return False
    return camera in (None, dataset.job.sensors[sensor].camera)


def _resized(values: np.ndarray, pinhole: Pinhole) -> np.ndarray:
    size = (pinhole.width, pinhole.height)
    if values.shape == size[::-1]:
        return values
    shrinks = values.shape[0] > pinhole.height
    return cv2.resize(values, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC)
