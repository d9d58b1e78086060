"""Audit of a sensor's geometry: contacts lie on its surface, held vertices rest, touched ones lie on the indenter."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from simgen.dataset.audit_finding import Finding, named, not_looked_at
from simgen.dataset.contact_patch import FACET_M, FIRST_TOUCH, ContactPatches
from simgen.dataset.pressed_indenters import poses_at_touch
from simgen.dataset.reader import Dataset
from simgen.dataset.stored_arrays import NOT_REACHED
from simgen.errors import InputError
from simgen.fem.nonlinear.status import has_values
from simgen.geometry.surface_normals import nearest_on_surface
from simgen.sensors.sensor_meshes import FARTHEST
from simgen.units import UM_PER_M

RIGID = 1e-9  # largest deviation of a rotation matrix from orthogonality: a few products in float64
FACET_DEG = 6.0
SHARDS_AT_ONCE = min(32, os.cpu_count() or 1)  # a shard of integers takes about 0.1 GB


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
    yield named(sensor, "contact distance", off * UM_PER_M, allowed_m(dataset, sensor) * UM_PER_M, "{:.1f} um")
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


class DisplacementFaults(NamedTuple):
    """Faults of the displacements of some presses; arrays (press, depth).

    moved : m, largest move of a held vertex
    missing : True where displacements are missing
    overlap : m, of vertices and indenter, beyond what the certificate says
    apart : m, distance of the nearest vertex from an indenter that presses
    """

    moved: np.ndarray
    missing: np.ndarray
    overlap: np.ndarray
    apart: np.ndarray


def displacements(
    dataset: Dataset, sensor: str, known: Mapping[int, DisplacementFaults] | None = None
) -> Iterator[Finding]:
    """Check that held vertices rest, touched vertices lie on the indenter, and converged samples are complete.

    known : shards that `DisplacementCheck` has looked at already
    """
    check, known = DisplacementCheck(dataset, sensor), known or {}
    if check.why_not:
        yield not_looked_at(sensor, "on the indenter", check.why_not)
    finished = dataset.finished()
    with ThreadPoolExecutor(SHARDS_AT_ONCE) as threads:
        found = threads.map(lambda shard: known[shard] if shard in known else check.shard(shard), finished)
        shape = (dataset.presses, len(dataset["depth"]))
        moved, missing, overlap, apart = whole = DisplacementFaults(*(np.zeros(shape) for _ in range(4)))
        for shard, of_shard in zip(finished, found, strict=True):
            presses = dataset.shard_presses(shard)
            for values, part in zip(whole, of_shard, strict=True):
                values[presses.start : presses.stop] = part
    if check.held is None:
        yield not_looked_at(sensor, "held vertices move", "the mesh that was imported does not say which are held")
    else:
        yield named(sensor, "held vertices move", moved, check.rounding, "{:g} m")
    yield named(sensor, "displacement gaps", missing, 0.0, "{:.0f}", total=True)
    if check.why_not or not len(check.patches.points):
        return
    allowed = allowed_m(dataset, sensor) * UM_PER_M
    yield named(sensor, "in the indenter", overlap * UM_PER_M, allowed, "{:.1f} um")
    yield named(sensor, "off the indenter", apart * UM_PER_M, allowed, "{:.1f} um")


class DisplacementCheck:
    """Checks displacements of one sensor, a shard at a time; ``why_not`` says why the indenter is left out."""

    def __init__(self, dataset: Dataset, sensor: str):
        self.dataset, self.sensor = dataset, sensor
        self.held, self.pose = dataset.get(f"{sensor}/held"), dataset.get(f"{sensor}/pose")
        self.scale = dataset.displacement_scale(sensor)  # of integers; None for floating-point numbers
        self.rounding, self.why_not = 0.0, ""
        if dataset.imported:
            self.rounding = dataset.attributes["source"]["meshes"][sensor]["rounding_m"]
            self.why_not = "the files that were imported do not say how far a mesh may overlap it"
            return
        try:
            self.patches = ContactPatches(dataset, sensor)
        except InputError as error:
            self.why_not = str(error)
            return
        # The first launch loads the kernel, which several threads must not do at once. Later ones run in parallel.
        if count := len(self.patches.points):
            self.patches.gap(np.zeros(1, int), np.array([FIRST_TOUCH]), np.zeros((1, count, 3)), np.eye(4)[None])

    def shard(self, shard: int) -> DisplacementFaults:
        """Look at a finished shard."""
        presses = self.dataset.shard_presses(shard)
        rows = slice(presses.start, presses.stop)
        stored = self.dataset.stored_displacement(self.sensor, rows)  # int16 takes a quarter of float64
        converged = has_values(self._stored("status", shard))
        held = stored[:, :, [] if self.held is None else self.held]
        held = np.nan_to_num(held) if self.scale is None else np.where(self._missing(held), 0, held)
        moved = np.abs(held).max(axis=(2, 3), initial=0) * (self.scale or 1.0)
        missing = converged & self._missing(stored).any(axis=(2, 3))
        overlap, apart = np.zeros(converged.shape), np.zeros(converged.shape)
        at = np.nonzero(converged & ~missing)
        if len(at[0]) and not self.why_not and len(self.patches.points):
            touched = self._stored("force", shard).any(axis=2)  # nothing touches a lifted indenter
            at_rest, nearest = self._nearest(shard, stored, *at)
            overlap[at] = -nearest - self._stored("certificate/max_penetration_m", shard)[at]
            apart[at] = np.where(touched[at], nearest - np.maximum(at_rest, 0.0)[at[0]], 0.0)
        return DisplacementFaults(moved, missing, overlap, apart)

    def _stored(self, key: str, shard: int) -> np.ndarray:
        return self.dataset.of_shard(f"{self.sensor}/{key}", shard)

    def _missing(self, stored: np.ndarray) -> np.ndarray:
        """Mask of the displacements without a value."""
        return ~np.isfinite(stored) if self.scale is None else stored == NOT_REACHED

    def _nearest(
        self, shard: int, stored: np.ndarray, press: np.ndarray, depth: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Least distance, m, of vertices and indenter: (n,) at rest, with the indenter at first touch of each press;
        and (s,) in samples, given by their press in the shard and their depth, (s,) each."""
        presses, points = self.dataset.shard_presses(shard), self.patches.points
        count = len(presses)
        moved = np.zeros((count + len(press), len(points), 3))
        moved[count:] = stored[press[:, None], depth[:, None], points]
        moved *= self.scale or 1.0
        press, depth = np.append(np.arange(count), press), np.append(np.full(count, FIRST_TOUCH), depth)
        at_contact, touch = self.dataset.of_shard("press/pose", shard), self._stored("touch", shard)
        touch = poses_at_touch(at_contact, touch, self.pose[presses.start : presses.stop])[press]
        least = self.patches.gap(presses.start + press, depth, moved, touch).min(axis=1)
        return least[:count], least[count:]
