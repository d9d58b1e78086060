"""Gaps between core and skin above each electrode, measured on the deformed skin.

A ray goes from each electrode along the core's outward normal. The gap is its length up to the inner surface of the
skin. One thread for each sample and electrode intersects the ray with the displaced triangles, on CPU or GPU. It tries
only triangles that lie near the ray at rest.
"""

from collections.abc import Iterator

import numpy as np
import trimesh
import warp as wp

from simgen.config.warp_device import check_device
from simgen.dataset.reader import Dataset
from simgen.errors import InputError
from simgen.fem.nonlinear.status import has_values
from simgen.geometry.surface_normals import nearest_on_surface
from simgen.sensors.sensor import place_electrodes
from simgen.sensors.sensor_geometry import cavity_faces, load_geometry

wp.set_module_options({"enable_backward": False})

# A ray is tested against triangles within this distance of the point where it hits the skin at rest. Presses of 2 mm
# move the skin by at most 3 mm.
REACH_M = 5e-3
# Rays start this far below the electrode, so that they also hit skin that overlaps the core; the gap is then negative.
# On coarse meshes skin overlaps the core by 0.2 mm, or 0.3 mm where facets bridge its edges. The core is 9 mm thick.
BELOW_M = 2e-3
AT_EDGE = 1e-9  # tolerance of barycentric coordinates, so that rounding makes no ray miss both triangles of an edge
SAMPLES_AT_ONCE = 512  # 50 MB of displacements of 4,000 vertices


@wp.kernel
def _gap_kernel(
    rest: wp.array(dtype=wp.vec3d),
    displacement: wp.array2d(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    first: wp.array(dtype=wp.int32),
    origin: wp.array(dtype=wp.vec3d),
    direction: wp.array(dtype=wp.vec3d),
    edge: wp.float64,
    # outputs
    gap_out: wp.array2d(dtype=wp.float64),
):
    """Distance from each origin along its direction to the nearest of its triangles; infinite if it hits none.

    Intersection of a ray and a triangle by Moeller and Trumbore (Journal of Graphics Tools 2, 1997).
    """
    sample, ray = wp.tid()
    o, d = origin[ray], direction[ray]
    zero, one = wp.float64(0.0), wp.float64(1.0)
    nearest = wp.float64(wp.inf)
    for k in range(first[ray], first[ray + 1]):
        corner = triangles[k]
        a = rest[corner[0]] + displacement[sample, corner[0]]
        ab = rest[corner[1]] + displacement[sample, corner[1]] - a
        ac = rest[corner[2]] + displacement[sample, corner[2]] - a
        across = wp.cross(d, ac)
        volume = wp.dot(ab, across)
        if volume != zero:  # else the ray lies in the triangle's plane
            from_a = o - a
            turned = wp.cross(from_a, ab)
            u = wp.dot(from_a, across) / volume
            v = wp.dot(d, turned) / volume
            t = wp.dot(ac, turned) / volume
            if u >= -edge and v >= -edge and u + v <= one + edge and t >= zero:
                nearest = wp.min(nearest, t)
    gap_out[sample, ray] = nearest


class GapGauge:
    """Measures the gaps of one sensor from displacements.

    rest, triangles : (vertex, 3) m and (triangle, 3), the inner surface of the skin, which faces the core
    electrodes, normals : (electrode, 3) m on the core, and the core's outward unit normals there
    rest_gap : (electrode,) m, the gaps at rest
    used : numbers of the vertices of the inner surface

    Raises `InputError` if there is no skin above an electrode at rest.
    """

    def __init__(
        self,
        rest: np.ndarray,
        triangles: np.ndarray,
        electrodes: np.ndarray,
        normals: np.ndarray,
        device: str = "cpu",
    ):
        check_device(device)
        self.device, self.n_electrodes = device, len(electrodes)
        self.used, inner = np.unique(triangles, return_inverse=True)
        rest, inner = rest[self.used], inner.reshape(-1, 3)
        self._rest = self._array(rest, wp.vec3d)
        self._rays = self._array(electrodes - BELOW_M * normals, wp.vec3d), self._array(normals, wp.vec3d)
        self._set_triangles(np.tile(inner, (self.n_electrodes, 1)), np.full(self.n_electrodes, len(inner)))
        self.rest_gap = self._measure(np.zeros((1, *rest.shape)))[0]
        if len(missed := np.flatnonzero(~np.isfinite(self.rest_gap))):
            raise InputError(f"electrode {missed[0] + 1}: no inner surface of the skin above it")
        meets = electrodes + self.rest_gap[:, None] * normals
        near = [inner[_distance_bound(rest[inner], point) <= REACH_M] for point in meets]
        self._set_triangles(np.concatenate(near), [len(some) for some in near])

    def __call__(self, displacement: np.ndarray) -> np.ndarray:
        """Gaps (sample, electrode), m, for displacements (sample, vertex, 3), m.

        Negative where skin overlaps the core, infinite where the ray misses the skin, NaN where a displacement is NaN.
        """
        return self.of_inner_surface(np.asarray(displacement, dtype=np.float64)[:, self.used])

    def of_inner_surface(self, displacement: np.ndarray) -> np.ndarray:
        """Gaps (sample, electrode), m, for float64 displacements (sample, vertex, 3), m, of the vertices `used`."""
        gap = self._measure(displacement)
        gap[~np.isfinite(displacement).all(axis=(1, 2))] = np.nan
        return gap

    def _set_triangles(self, triangles: np.ndarray, counts: np.ndarray) -> None:
        """Set the triangles that each ray is tested against: ``counts`` (electrode,) of them, ray after ray."""
        self._triangles = self._array(triangles, wp.vec3i)
        self._first = self._array(np.concatenate([[0], np.cumsum(counts)]), wp.int32)

    def _measure(self, moved: np.ndarray) -> np.ndarray:
        moved = self._array(moved, wp.vec3d)
        gap = wp.empty((len(moved), self.n_electrodes), dtype=wp.float64, device=self.device)
        inputs = [self._rest, moved, self._triangles, self._first, *self._rays, AT_EDGE]
        wp.launch(_gap_kernel, dim=gap.shape, inputs=inputs, outputs=[gap], device=self.device)
        return gap.numpy() - BELOW_M

    def _array(self, values: np.ndarray, kind: type) -> wp.array:
        return wp.array(np.ascontiguousarray(values), dtype=kind, device=self.device)


def _distance_bound(corners: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Lower bound (t,) of the distance of triangles (t, 3, 3) from a point, by a ball around each."""
    middle = corners.mean(axis=1)
    radius = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    return np.linalg.norm(middle - point, axis=1) - radius


def gauge_of(dataset: Dataset, sensor: str, device: str = "cpu") -> GapGauge:
    """Make the gauge of a dataset's sensor, from the sensor model that the dataset's job names.

    Raises `InputError` if there is no such sensor, its model is missing or lacks core or electrodes, or its mesh has no
    cavity.
    """
    electrodes, normals = electrodes_of(dataset, sensor)
    where = f"{dataset.path}: sensor {sensor}"
    rest, triangles = dataset[f"{sensor}/rest_positions"], dataset[f"{sensor}/surface_triangles"]
    inner = triangles[cavity_faces(trimesh.Trimesh(rest, triangles, process=False))]
    if not len(inner):
        raise InputError(f"{where}: its mesh has no cavity; electrodes measure a gap between skin and core")
    try:
        return GapGauge(rest, inner, electrodes, normals, device)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def electrodes_of(dataset: Dataset, sensor: str) -> tuple[np.ndarray, np.ndarray]:
    """Electrodes (electrode, 3), m, on the core of a dataset's sensor, and the core's outward unit normals there.

    Raises `InputError` if there is no such sensor, or its model is missing or lacks core or electrodes.
    """
    if sensor not in dataset.sensors:
        raise InputError(f"{dataset.path}: sensor {sensor!r}: allowed: {', '.join(dataset.sensors)}")
    model = load_geometry(dataset.job.locate(dataset.job.sensors[sensor].model))
    if model.core is None or model.description.electrodes is None:
        where = f"{dataset.path}: sensor {sensor}"
        raise InputError(f"{where}: its model has no electrodes; allowed: a model with core and electrodes")
    electrodes = place_electrodes(model.description.electrodes, model.core)
    return electrodes, outward_normals(model.core, electrodes)


def outward_normals(core: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Unit normals (n, 3) of the core at points (n, 3) on it, smoothed over its facets."""
    _, normals = nearest_on_surface(np.asarray(core.vertices), np.asarray(core.faces), points)
    return normals[:, 0]


def gaps(dataset: Dataset, sensor: str, press: np.ndarray, step: np.ndarray, device: str = "cpu") -> np.ndarray:
    """Gaps (sample, electrode), m, of samples given by press and index of the depth, both (sample,) integers.

    Raises `InputError` as `gauge_of` does, for a sample that is missing or did not converge, and if skin has left an
    electrode's ray.
    """
    press, step = _checked_samples(dataset, sensor, press, step)
    gauge = gauge_of(dataset, sensor, device)
    found = np.full((len(press), gauge.n_electrodes), np.nan)
    for rows, displacement in _displacements(dataset, sensor, press, step):
        found[rows] = gauge(displacement)
    return checked_gaps(found, f"{dataset.path}/{sensor}", press, step)


def checked_gaps(gap: np.ndarray, where: str, press: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Return gaps (sample, electrode), m, as they are. Raises `InputError` if skin has left an electrode's ray."""
    if not np.isfinite(gap).all():
        sample, electrode = np.argwhere(~np.isfinite(gap))[0]
        raise InputError(
            f"{where}: press {press[sample]}, depth {step[sample]}: no skin within {1e3 * REACH_M:g} mm of where it is "
            f"at rest above electrode {electrode + 1}; `simgen check` says more"
        )
    return gap


def _displacements(
    dataset: Dataset, sensor: str, press: np.ndarray, step: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Rows of samples and their displacements (row, vertex, 3), press by press, at most `SAMPLES_AT_ONCE`."""
    order = np.argsort(press, kind="stable")
    starts = np.flatnonzero(np.diff(press[order], prepend=-1))
    for rows in np.split(order, starts[1:]):
        for some in np.array_split(rows, -(-len(rows) // SAMPLES_AT_ONCE)):
            first, end = step[some].min(), step[some].max() + 1
            moved = dataset.displacement(sensor, int(press[some[0]]), slice(int(first), int(end)))
            yield some, moved[step[some] - first]


def _checked_samples(
    dataset: Dataset, sensor: str, press: np.ndarray, step: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    press, step = np.asarray(press), np.asarray(step)
    if press.ndim != 1 or press.shape != step.shape or {press.dtype.kind, step.dtype.kind} - {"i", "u"}:
        raise InputError(f"samples: press {press.shape}, step {step.shape}; allowed: two lists of as many integers")
    if not len(press):
        raise InputError("samples: none; allowed: 1 or more")
    for name, values, count in (("press", press, dataset.presses), ("step", step, len(dataset["depth"]))):
        if values.min() < 0 or values.max() >= count:
            raise InputError(f"samples: {name} {values.min()} to {values.max()}; allowed: 0 to {count - 1}")
    if sensor in dataset.sensors and (bad := ~has_values(dataset[f"{sensor}/status"][press, step])).any():
        at = np.argmax(bad)
        raise InputError(f"{dataset.path}/{sensor}: press {press[at]}, depth {step[at]}: it did not converge; allowed: "
                         "converged samples")  # fmt: skip
    return press.astype(np.int64), step.astype(np.int64)
