"""Audit of a sensor's geometry: contacts lie on its surface, held vertices rest, touched ones lie on the indenter."""

import os
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import warp as wp

from simgen.config.indenter_path import moved
from simgen.config.warp_device import start_warp
from simgen.dataset.audit_finding import Finding, named, not_looked_at
from simgen.dataset.pressed_indenters import pressed_indenters
from simgen.dataset.reader import Dataset
from simgen.dataset.touchable import touchable_points
from simgen.errors import InputError
from simgen.fem.nonlinear.status import has_values
from simgen.geometry.rigid_shape import shape_array
from simgen.geometry.signed_distance import RigidShape, distance
from simgen.geometry.surface_normals import nearest_on_surface
from simgen.sensors.indenter_pose import advanced
from simgen.sensors.sensor_meshes import FARTHEST
from simgen.units import MM, MM_PER_M

wp.set_module_options({"enable_backward": False})

RIGID = 1e-9  # largest deviation of a rotation matrix from orthogonality: a few products in float64
# The output mesh is a polyhedron. A contact on the true surface lies off its facets by up to edge^2 / (8 radius), which
# is 0.05 mm for edges of 1.6 mm on a radius of 6.5 mm, and normals differ by some degrees. Its vertices lie off the
# simulated surface too, so they overlap the indenter more than the certificate says: by up to 7 um in the smoke
# dataset, by 41 um with linear elements.
FACET_M = 5e-5
FACET_DEG = 6.0
SHARDS_AT_ONCE = min(8, os.cpu_count() or 1)  # a shard takes about 0.3 GB of memory
LAUNCHING = threading.Lock()  # Warp's kernels, one at a time


@wp.kernel
def _nearest_vertex_kernel(
    shapes: wp.array(dtype=RigidShape),
    indenter: wp.array(dtype=wp.int32),
    rest: wp.array(dtype=wp.vec3d),
    displacement: wp.array4d(dtype=wp.float64),
    rotation: wp.array(dtype=wp.mat33d),
    press: wp.array(dtype=wp.int32),
    depth: wp.array(dtype=wp.int32),
    origin: wp.array(dtype=wp.vec3d),
    # outputs
    distance_out: wp.array(dtype=wp.float64),
):
    """Least signed distance, mm, of displaced vertices from the indenter of each sample; depth -1 is at rest."""
    sample, vertex = wp.tid()
    i, j = press[sample], depth[sample]
    x = rest[vertex] - origin[sample]
    if j >= 0:
        x += wp.vec3d(displacement[i, j, vertex, 0], displacement[i, j, vertex, 1], displacement[i, j, vertex, 2])
    local = wp.transpose(rotation[sample]) * x
    wp.atomic_min(distance_out, sample, distance(shapes[indenter[i]], wp.float64(MM_PER_M) * local))


def pairing(dataset: Dataset, sensor: str) -> Iterator[Finding]:
    """Check that each contact, moved into the sensor's frame, lies on its surface with the same normal."""
    if dataset.get("press/contact_pose") is None:
        yield not_looked_at(sensor, "contacts", "the files that were imported do not say where they are")
        return
    contact, normal = dataset["press/contact_pose"], dataset["press/contact_normal"]
    pose = dataset[f"{sensor}/pose"]
    rotation = pose[:, :3, :3]
    skew = np.abs(np.swapaxes(rotation, 1, 2) @ rotation - np.eye(3)).max(axis=(1, 2))
    yield named(sensor, "poses, rigidity", skew, RIGID, "{:.1e}")

    point = np.einsum("nji,nj->ni", rotation, contact[:, :3, 3] - pose[:, :3, 3])
    direction = np.einsum("nji,nj->ni", rotation, normal)
    vertices, triangles = dataset[f"{sensor}/rest_positions"], dataset[f"{sensor}/surface_triangles"]
    off, normals = nearest_on_surface(vertices, triangles, point)
    cosine = np.clip(np.einsum("ni,nki->nk", direction, normals).max(axis=1), -1.0, 1.0)
    yield named(sensor, "contact distance", off * 1e6, allowed_m(dataset, sensor) * 1e6, "{:.1f} um")
    angle = np.degrees(np.arccos(cosine))
    if _has_mesh_of_the_job(dataset, sensor):
        yield Finding(sensor, "contact angle", f"{angle.max(initial=0.0):.2f} deg", "stated", None)
    else:
        yield named(sensor, "contact angle", angle, FACET_DEG, "{:.2f} deg")


def allowed_m(dataset: Dataset, sensor: str) -> float:
    """Largest allowed distance, m, of a contact or of the indenter from the output mesh.

    An output mesh from a job's own file can also lie off the gel, as far as `sensor_meshes.output_from_file` allows.
    """
    if not _has_mesh_of_the_job(dataset, sensor):
        return FACET_M
    return FACET_M + round(FARTHEST * float(np.ptp(dataset[f"{sensor}/rest_positions"], axis=0).max()), 5)


def _has_mesh_of_the_job(dataset: Dataset, sensor: str) -> bool:
    return dataset.job.sensors[sensor].output is not None


def displacements(dataset: Dataset, sensor: str) -> Iterator[Finding]:
    """Check that held vertices rest, touched ones lie on the indenter, and converged samples have displacements."""
    start_warp()
    check = _DisplacementCheck(dataset, sensor)
    if check.why_not:
        yield not_looked_at(sensor, "on the indenter", check.why_not)
    with ThreadPoolExecutor(SHARDS_AT_ONCE) as threads:
        checked = list(threads.map(check.shard, dataset.finished()))
    shape = (dataset.presses, len(dataset["depth"]))
    moved, gap, overlap, apart = (np.zeros(shape) for _ in range(4))
    for rows, *values in checked:
        for whole, part in zip((moved, gap, overlap, apart), values, strict=True):
            whole[rows] = part
    if check.held is None:
        yield not_looked_at(sensor, "held vertices move", "the mesh that was imported does not say which are held")
    else:
        yield named(sensor, "held vertices move", moved, check.rounding, "{:g} m")
    yield named(sensor, "displacement gaps", gap, 0.0, "{:.0f}", total=True)
    if check.why_not or not len(check.touchable):
        return
    allowed = allowed_m(dataset, sensor) * 1e6
    yield named(sensor, "in the indenter", overlap * 1e6, allowed, "{:.1f} um")
    yield named(sensor, "off the indenter", apart * 1e6, allowed, "{:.1f} um")


class _DisplacementCheck:
    """Checks displacements of one sensor, a shard at a time; ``why_not`` says why the indenter is left out."""

    def __init__(self, dataset: Dataset, sensor: str):
        self.dataset, self.sensor = dataset, sensor
        self.status = dataset[f"{sensor}/status"]
        self.held = dataset.get(f"{sensor}/held")
        self.rounding, self.why_not = 0.0, ""
        if dataset.imported:
            self.rounding = dataset.attributes["source"]["meshes"][sensor]["rounding_m"]
            self.why_not = "the files that were imported do not say how far a mesh may overlap it"
            return
        self.touchable = touchable_points(dataset, sensor)
        self.rest = dataset[f"{sensor}/rest_positions"][self.touchable]
        self.stated = dataset[f"{sensor}/certificate/max_penetration_m"]
        first_touch = advanced(dataset["press/pose"], dataset[f"{sensor}/touch"])
        self.first_touch = np.linalg.inv(dataset[f"{sensor}/pose"]) @ first_touch
        self.touched = dataset[f"{sensor}/force"].any(axis=2)  # nothing touches a lifted indenter
        self.indenter = dataset["press/indenter"]
        try:
            self.shapes = shape_array([indenter.shape() for indenter in pressed_indenters(dataset)])
        except InputError as error:
            self.why_not = str(error)

    def shard(self, shard: int) -> tuple:
        """Rows of presses, and four arrays (press, depth): largest move of held vertices, m; missing displacements;
        overlap of vertices and indenter beyond the certificate's, m; gap between indenter and nearest vertex, m."""
        presses = self.dataset.shard_presses(shard)
        rows = slice(presses.start, presses.stop)
        displacement = self.dataset.displacement(self.sensor, rows)
        converged = has_values(self.status[rows])
        held = displacement[:, :, [] if self.held is None else self.held]
        moved = np.nan_to_num(np.abs(held)).max(axis=(2, 3), initial=0.0)
        gap = converged & ~np.isfinite(displacement).all(axis=(2, 3))
        overlap, apart = np.zeros(converged.shape), np.zeros(converged.shape)
        at = np.nonzero(converged & ~gap)
        if len(at[0]) and not self.why_not and len(self.touchable):
            at_rest, nearest = self._nearest(rows, displacement, *at)
            overlap[at] = -nearest - self.stated[rows][at]
            apart[at] = np.where(self.touched[rows][at], nearest - np.maximum(at_rest, 0.0)[at[0]], 0.0)
        return rows, moved, gap, overlap, apart

    def _nearest(
        self, rows: slice, displacement: np.ndarray, press: np.ndarray, depth: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Least distance, m, of vertices from the indenter: at rest, at first touch of each press (n,); and in samples
        (s,), given by rows in the shard and depths."""
        count, path = rows.stop - rows.start, self.dataset.indenter_path
        press, depth = np.append(np.arange(count), press), np.append(np.full(count, -1), depth)
        offsets = np.where(depth[:, None] < 0, 0.0, path.offsets_m[depth])
        turns = np.where(depth < 0, 0.0, path.turns_rad[depth])
        pose = moved(self.first_touch[rows][press], offsets, turns)
        arrays = [
            (self.indenter[rows], wp.int32),
            (self.rest, wp.vec3d),
            (displacement[:, :, self.touchable], wp.float64),
            (pose[:, :3, :3], wp.mat33d),
            (press, wp.int32),
            (depth, wp.int32),
            (pose[:, :3, 3], wp.vec3d),
        ]
        inputs = [wp.array(np.ascontiguousarray(values), dtype=kind, device="cpu") for values, kind in arrays]
        least = wp.full(len(press), np.inf, dtype=wp.float64, device="cpu")
        with LAUNCHING:
            dim = (len(press), len(self.rest))
            wp.launch(_nearest_vertex_kernel, dim=dim, inputs=[self.shapes, *inputs], outputs=[least], device="cpu")
        distances = least.numpy() * MM
        return distances[:count], distances[count:]
