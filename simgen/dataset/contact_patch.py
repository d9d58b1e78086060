"""Contact patches: the points of a sensor's touchable surface that touch the indenter."""

from functools import cached_property

import numpy as np
import warp as wp

from simgen.config.indenter_path import moved
from simgen.config.warp_device import start_warp
from simgen.dataset.pressed_indenters import first_touch, pressed_indenters
from simgen.dataset.reader import Dataset
from simgen.dataset.touchable import touchable_points
from simgen.errors import InputError
from simgen.geometry.rigid_shape import shape_array
from simgen.geometry.signed_distance import RigidShape, distance
from simgen.units import MM, MM_PER_M

wp.set_module_options({"enable_backward": False})

# The output mesh is a polyhedron. A contact on the true surface lies off its facets by up to edge^2 / (8 radius), which
# is 0.05 mm for edges of 1.6 mm on a radius of 6.5 mm, and normals differ by some degrees. Its vertices lie off the
# simulated surface too, so they overlap the indenter more than the certificate says: by up to 7 um in the smoke
# dataset, by 41 um with linear elements.
FACET_M = 5e-5
FIRST_TOUCH = -1  # number of the step at which the indenter first touches


@wp.kernel
def _distance_kernel(
    shapes: wp.array(dtype=RigidShape),
    indenter: wp.array(dtype=wp.int32),
    rotation: wp.array(dtype=wp.mat33d),
    tip: wp.array(dtype=wp.vec3d),
    rest: wp.array(dtype=wp.vec3d),
    displacement: wp.array2d(dtype=wp.vec3d),
    # outputs
    distance_out: wp.array2d(dtype=wp.float64),
):
    """Signed distance, mm, of displaced points (m) from each sample's indenter."""
    sample, point = wp.tid()
    local = wp.transpose(rotation[sample]) * (rest[point] + displacement[sample, point] - tip[sample])
    distance_out[sample, point] = distance(shapes[indenter[sample]], wp.float64(MM_PER_M) * local)


class ContactPatches:
    """Contact patches of one sensor. A point touches if it is inside the indenter or at most `FACET_M` away.

    points : (point,) vertices of the touchable surface
    device : where distances are computed, cpu or cuda:N

    Raises `InputError` for an imported dataset, which does not know its touchable surface, and for an indenter whose
    file has changed.
    """

    def __init__(self, dataset: Dataset, sensor: str, device: str = "cpu"):
        if dataset.imported:
            raise InputError(f"{dataset.path}: the files that were imported do not say what touches the indenter")
        start_warp()
        self.device, self.points = device, touchable_points(dataset, sensor)
        self._rest = dataset[f"{sensor}/rest_positions"][self.points]
        self._shapes = shape_array([indenter.shape() for indenter in pressed_indenters(dataset)], device)
        self._indenter, self._path = dataset["press/indenter"], dataset.indenter_path
        self._dataset, self._sensor = dataset, sensor

    @cached_property
    def _first_touch(self) -> np.ndarray:
        return first_touch(self._dataset, self._sensor)

    def touching(self, press: np.ndarray, step: np.ndarray, displacement: np.ndarray | wp.array) -> np.ndarray:
        """Mask (sample, point) of points that touch the indenter; arguments as in `gap`."""
        return self.gap(press, step, displacement) <= FACET_M

    def gap(
        self, press: np.ndarray, step: np.ndarray, displacement: np.ndarray | wp.array,
        touch: np.ndarray | None = None,
    ) -> np.ndarray:  # fmt: skip
        """Signed distance (sample, point), m, of points from the indenter.

        press, step : (sample,) each; a step can be `FIRST_TOUCH`
        displacement : (sample, point, 3) m, of `points` alone; or (sample, point) of ``wp.vec3d`` on the device
        touch : (sample, 4, 4) poses at first touch; by default those of the dataset
        """
        on_path = np.asarray(step) != FIRST_TOUCH
        offsets, turns = self._path.offsets_m[step] * on_path[:, None], self._path.turns_rad[step] * on_path
        pose = moved(self._first_touch[press] if touch is None else touch, offsets, turns)
        arrays = [
            (self._indenter[press], wp.int32),
            (pose[:, :3, :3], wp.mat33d),
            (pose[:, :3, 3], wp.vec3d),
            (self._rest, wp.vec3d),
        ]
        inputs = [wp.array(np.ascontiguousarray(values), dtype=kind, device=self.device) for values, kind in arrays]
        if not isinstance(displacement, wp.array):
            displacement = wp.array(np.asarray(displacement, np.float64), dtype=wp.vec3d, device=self.device)
        found = wp.empty(displacement.shape, dtype=wp.float64, device=self.device)
        inputs = [self._shapes, *inputs, displacement]
        wp.launch(_distance_kernel, dim=found.shape, inputs=inputs, outputs=[found], device=self.device)
        return found.numpy() * MM
