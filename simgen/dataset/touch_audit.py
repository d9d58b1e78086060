"""Audit of a sensor's geometry: contacts on its surface, what is held at rest, what is touched on the indenter."""

import os
import threading
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import warp as wp
from scipy.spatial import cKDTree
from trimesh.triangles import closest_point

from simgen.config.indenter_path import moved
from simgen.config.warp_device import start_warp
from simgen.dataset.audit_finding import Finding, named, not_looked_at
from simgen.dataset.provenance import difference
from simgen.dataset.reader import Dataset
from simgen.errors import InputError
from simgen.fem.nonlinear.status import has_values
from simgen.geometry.rigid_shape import shape_array
from simgen.geometry.signed_distance import RigidShape, distance
from simgen.sensors.indenter import Indenter, chosen_indenter
from simgen.sensors.polar_bodies import advanced
from simgen.sensors.sensor_meshes import FARTHEST

wp.set_module_options({"enable_backward": False})

RIGID = 1e-9  # of a rotation matrix against orthogonality: float64 products of a few rotations
# The output mesh is a polyhedron: a contact on the true surface lies off its facets by up to
# edge^2 / (8 radius), 0.05 mm for edges of 1.6 mm on a radius of 6.5 mm; its normals are some degrees off. For the
# same reason its vertices lie off the surface that was pressed, and overlap the indenter by more than its certificate
# says: by up to 7 um in the smoke dataset, 41 um with linear elements.
FACET_M = 5e-5
FACET_DEG = 6.0
SHARDS_AT_ONCE = min(8, os.cpu_count() or 1)  # each takes some 0.3 GB while it is looked at
NEAREST_TRIANGLES = 64  # by their centroids, among which the closest point is sought
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
    """Least signed distance, mm, of displaced vertices from a press's shape, for some samples; depth -1 is at rest."""
    sample, vertex = wp.tid()
    i, j = press[sample], depth[sample]
    x = rest[vertex] - origin[sample]
    if j >= 0:
        x += wp.vec3d(displacement[i, j, vertex, 0], displacement[i, j, vertex, 1], displacement[i, j, vertex, 2])
    local = wp.transpose(rotation[sample]) * x
    wp.atomic_min(distance_out, sample, distance(shapes[indenter[i]], wp.float64(1000.0) * local))


def pairing(dataset: Dataset, sensor: str) -> Iterator[Finding]:
    """The contact, brought into the sensor's frame by its pose, lies on its surface with its normal."""
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
    """The largest distance, m, of a contact or of the indenter from the output mesh.

    A mesh that the job names may lie off the gel besides, as far as `sensor_meshes.output_from_file` allows.
    """
    if not _has_mesh_of_the_job(dataset, sensor):
        return FACET_M
    return FACET_M + round(FARTHEST * float(np.ptp(dataset[f"{sensor}/rest_positions"], axis=0).max()), 5)


def _has_mesh_of_the_job(dataset: Dataset, sensor: str) -> bool:
    return dataset.job.sensors[sensor].output is not None


def displacements(dataset: Dataset, sensor: str) -> Iterator[Finding]:
    """Held vertices rest; what is touched lies on the indenter; nothing is missing where a press converged."""
    start_warp()
    look = _Look(dataset, sensor)
    if look.why_not:
        yield not_looked_at(sensor, "on the indenter", look.why_not)
    with ThreadPoolExecutor(SHARDS_AT_ONCE) as threads:
        seen = list(threads.map(look.at, dataset.finished()))
    shape = (dataset.presses, len(dataset["depth"]))
    moved, gap, overlap, apart = (np.zeros(shape) for _ in range(4))
    for rows, *values in seen:
        for whole, part in zip((moved, gap, overlap, apart), values, strict=True):
            whole[rows] = part
    if look.held is None:
        yield not_looked_at(sensor, "held vertices move", "the mesh that was imported does not say which are held")
    else:
        yield named(sensor, "held vertices move", moved, look.rounding, "{:g} m")
    yield named(sensor, "displacement gaps", gap, 0.0, "{:.0f}", total=True)
    if look.why_not or not len(look.touchable):
        return
    allowed = allowed_m(dataset, sensor) * 1e6
    yield named(sensor, "in the indenter", overlap * 1e6, allowed, "{:.1f} um")
    yield named(sensor, "off the indenter", apart * 1e6, allowed, "{:.1f} um")


class _Look:
    """At the displacements of one sensor, a shard at a time."""

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

    def at(self, shard: int) -> tuple:
        """Rows of presses, and for each (press, depth): greatest move of what is held, m; whether displacements are
        missing; how far vertices are in the indenter, and how far the nearest is from it, beyond what they may, m."""
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
        """Least distance of vertices from the indenter, m: of each press (n,) at first touch, undisplaced, and of
        samples (s,), given by their rows in the shard and their depths."""
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
        distances = least.numpy() * 1e-3
        return distances[:count], distances[count:]


def touchable_points(dataset: Dataset | Mapping[str, np.ndarray], sensor: str) -> np.ndarray:
    """(n,) the vertices of a sensor's surface that may touch an indenter."""
    on_surface = np.unique(dataset[f"{sensor}/surface_triangles"])
    return on_surface[dataset[f"{sensor}/touchable"][on_surface]]


def pressed_indenters(dataset: Dataset) -> list[Indenter]:
    """The indenters of the dataset. Raises `InputError` if one, a user's own file, has changed or is gone."""
    return [pressed_indenter(dataset, index) for index in range(len(dataset.indenters))]


def pressed_indenter(dataset: Dataset, index: int) -> Indenter:
    """One of them."""
    name, own = dataset.indenters[index], chosen_indenter(dataset.job, index)
    stored = dataset.attributes.get("indenters", {}).get(name)
    if stored is not None and (changes := difference(stored, own.identity())):
        raise InputError(f"{name}: not the indenter that was pressed ({'; '.join(changes)})")
    return own


def nearest_on_surface(
    vertices: np.ndarray, triangles: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Distance (n,) of points (n, 3) from a triangulated surface, and normals (n, 2, 3) where it is nearest.

    The first normal is smoothed, which suits a curved surface; the second, the facet's own, suits a crease.
    """
    corners = vertices[triangles]
    count = min(NEAREST_TRIANGLES, len(triangles))
    _, near = cKDTree(corners.mean(axis=1)).query(points, k=count)
    near = np.reshape(near, (len(points), count))
    repeated = np.repeat(points, count, axis=0)
    # trimesh's tolerance is absolute and meant for triangles of about unit size.
    size = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1).mean()
    closest = size * closest_point(corners[near.ravel()] / size, repeated / size).reshape(
        len(points), count, 3
    )
    distance = np.linalg.norm(closest - points[:, None], axis=2)
    best = distance.argmin(axis=1)
    row = np.arange(len(points))
    nearest = corners[near[row, best]]
    normals = vertex_normals(vertices, triangles)[triangles[near[row, best]]]
    smoothed = np.einsum("nk,nki->ni", _barycentric(nearest, closest[row, best]), normals)
    facet = np.cross(nearest[:, 1] - nearest[:, 0], nearest[:, 2] - nearest[:, 0])
    both = np.stack([smoothed, facet], axis=1)
    return distance[row, best], both / np.linalg.norm(both, axis=2, keepdims=True)


def vertex_normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Area-weighted, not normalised to one where no triangle meets the vertex."""
    a, b, c = np.swapaxes(vertices[triangles], 0, 1)
    facet = np.cross(b - a, c - a)
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, triangles[:, corner], facet)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)


def _barycentric(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    a, b, c = np.swapaxes(corners, 0, 1)
    whole = np.cross(b - a, c - a)
    area = np.einsum("ni,ni->n", whole, whole)
    of_b = np.einsum("ni,ni->n", np.cross(points - a, c - a), whole) / area
    of_c = np.einsum("ni,ni->n", np.cross(b - a, points - a), whole) / area
    return np.stack([1.0 - of_b - of_c, of_b, of_c], axis=1)
