"""Audit of a dataset: is it whole, unchanged, converged, paired, and held where it should be held?

All is computed again from what is stored; what the run said about itself is not believed, except for the
certificates, which the solver alone can know.
"""

import hashlib
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from trimesh.triangles import closest_point

from simgen.dataset import SPLITS, Dataset

FORCE_BALANCE = 1e-3  # of the contact force
LIQUID_VOLUME = 1e-6  # of the cavity's volume
RIGID = 1e-9  # of a rotation matrix against orthogonality: float64 products of a few rotations
# The output mesh is a polyhedron: a contact on the true surface lies off its facets by up to
# edge^2 / (8 radius), 0.05 mm for edges of 1.6 mm on a radius of 6.5 mm; its normals are some degrees off.
PAIRING_DISTANCE_M = 5e-5
PAIRING_ANGLE_DEG = 6.0
SHARDS_AT_ONCE = min(8, os.cpu_count() or 1)  # each takes some 0.3 GB while it is looked at
NEAREST_TRIANGLES = 64  # by their centroids, among which the closest point is sought


@dataclass(frozen=True)
class Finding:
    """One line of the audit; `passed` is None for a figure that is stated but has no limit."""

    subject: str
    what: str
    found: str
    allowed: str
    passed: bool | None
    note: str = ""

    @property
    def failed(self) -> bool:
        return self.passed is not None and not self.passed


def check(dataset: Dataset) -> list[Finding]:
    """All findings, the whole dataset first, then each sensor."""
    findings = [*_whole(dataset), *_layout(dataset), *_splits(dataset)]
    for sensor in dataset.sensors:
        findings += [
            *_certificates(dataset, sensor),
            *_displacements(dataset, sensor),
            *_pairing(dataset, sensor),
        ]
    return findings


def passes(findings: list[Finding]) -> bool:
    return not any(finding.failed for finding in findings)


def _whole(dataset: Dataset) -> Iterator[Finding]:
    missing = [press for shard in dataset.unfinished() for press in dataset.shard_presses(shard)]
    found = f"{dataset.presses - len(missing)} of {dataset.presses}"
    if missing:
        found += f", not {missing[0]}"
    yield Finding("dataset", "presses", found, "all", not missing)
    sums = dataset.checksums()
    with ThreadPoolExecutor() as threads:
        found_sums = threads.map(lambda name: _sha256(dataset, name), sums)
        wrong = [name for name, found in zip(sums, found_sums, strict=True) if found != sums[name]]
    found = f"{len(sums) - len(wrong)} of {len(sums)}" + (f", not {wrong[0]}" if wrong else "")
    yield Finding("dataset", "checksums", found, "all", not wrong)
    same = dataset.job.hash == dataset.attributes["job_hash"]
    yield Finding("dataset", "job hash", dataset.job.hash[:12], dataset.attributes["job_hash"][:12], same)


def _sha256(dataset: Dataset, name: str) -> str | None:
    file = dataset.path / name
    return hashlib.sha256(file.read_bytes()).hexdigest() if file.is_file() else None


def _layout(dataset: Dataset) -> Iterator[Finding]:
    wrong = []
    for name, array in dataset.arrays.items():
        stored = dataset.root.get(name)
        shape = (dataset.presses, *array.shape)
        if stored is None or stored.shape != shape or stored.dtype != array.dtype:
            wrong.append(name)
    found = f"{len(dataset.arrays) - len(wrong)} of {len(dataset.arrays)}" + (
        f", not {wrong[0]}" if wrong else ""
    )
    yield Finding("dataset", "array shapes", found, "all", not wrong)
    same = np.array_equal(dataset["depth"], dataset.job.depths_m)
    yield Finding("dataset", "depths", f"{len(dataset['depth'])}", "the job's", same)


def _splits(dataset: Dataset) -> Iterator[Finding]:
    trajectory, split = dataset["press/trajectory"], dataset["press/split"]
    pairs = np.unique(np.stack([trajectory, split]), axis=1)
    shared = pairs.shape[1] - len(np.unique(trajectory))
    counts = np.bincount(pairs[1], minlength=len(SPLITS))
    shown = " / ".join(str(count) for count in counts)
    yield Finding("dataset", "splits", shown, "disjoint", shared == 0)


def _certificates(dataset: Dataset, sensor: str) -> Iterator[Finding]:
    status = dataset[f"{sensor}/status"]
    converged = status == 0
    found = f"{np.count_nonzero(converged)} of {status.size}"
    yield Finding(
        sensor, "samples converged", found, "all", bool(converged.all()), _failures(dataset, status)
    )

    def worst(key: str, of=np.max) -> float:
        values = dataset[f"{sensor}/certificate/{key}"][converged]
        return float(of(values)) if values.size else np.nan

    limits = [
        ("residual", "residual", dataset.job.solver.residual_tolerance),
        ("contact_error", "contact error", dataset.job.solver.contact_tolerance),
        ("force_balance", "force balance", FORCE_BALANCE),
    ]
    if dataset.job.sensors[sensor].fluid != "none":
        limits.append(("liquid_volume_error", "liquid volume, change", LIQUID_VOLUME))
    for key, what, limit in limits:
        value = worst(key)
        yield Finding(sensor, what, f"{value:.2e}", f"<= {limit:g}", value <= limit)
    value = worst("min_det_F", np.min)
    yield Finding(sensor, "det F, least", f"{value:.3f}", "> 0", value > 0)
    yield Finding(sensor, "elements inverted in part", f"{worst('inverted_elements'):.0f} at most", "stated", None)
    rms, deepest = worst("rms_penetration_m"), worst("max_penetration_m")
    shown = f"rms {rms * 1e6:.1f}, max {deepest * 1e6:.1f} um"
    yield Finding(sensor, "penetration", shown, "stated", None)


def _failures(dataset: Dataset, status: np.ndarray) -> str:
    """What befell the samples that did not converge, one line for each status."""
    sentences = {**dataset.attributes["status"], "-1": "Not there yet."}
    lines = []
    for code in np.unique(status[status != 0]):
        press, depth = np.argwhere(status == code)[0]
        count = np.count_nonzero(status == code)
        lines.append(f"{count} samples, the first at press {press}, depth {depth}: {sentences[str(code)]}")
    return "\n".join(lines)


def _displacements(dataset: Dataset, sensor: str) -> Iterator[Finding]:
    held, status = dataset[f"{sensor}/held"], dataset[f"{sensor}/status"]

    def look_at(shard: int) -> tuple[float, int]:
        presses = dataset.shard_presses(shard)
        rows = slice(presses.start, presses.stop)
        displacement = dataset.displacement(sensor, rows)
        moved = float(np.nanmax(np.abs(displacement[:, :, held]), initial=0.0))
        reached = np.isfinite(displacement).all(axis=(2, 3))
        return moved, int(np.count_nonzero((status[rows] == 0) & ~reached))

    with ThreadPoolExecutor(SHARDS_AT_ONCE) as threads:
        seen = list(threads.map(look_at, dataset.finished()))
    moved, gaps = max((each for each, _ in seen), default=0.0), sum(each for _, each in seen)
    yield Finding(sensor, "held vertices move", f"{moved:g} m", "0 m", moved == 0)
    yield Finding(sensor, "displacement gaps", f"{gaps}", "0", gaps == 0)


def _pairing(dataset: Dataset, sensor: str) -> Iterator[Finding]:
    """The contact, brought into the sensor's frame by its pose, lies on its surface with its normal."""
    _, first = np.unique(dataset["press/trajectory"], return_index=True)
    contact, normal = dataset["press/contact_pose"][first], dataset["press/contact_normal"][first]
    pose = dataset[f"{sensor}/pose"][first]
    rotation = pose[:, :3, :3]
    skew = np.abs(np.swapaxes(rotation, 1, 2) @ rotation - np.eye(3)).max()
    yield Finding(sensor, "poses, rigidity", f"{skew:.1e}", f"<= {RIGID:g}", bool(skew <= RIGID))

    point = np.einsum("nji,nj->ni", rotation, contact[:, :3, 3] - pose[:, :3, 3])
    direction = np.einsum("nji,nj->ni", rotation, normal)
    vertices, triangles = dataset[f"{sensor}/rest_positions"], dataset[f"{sensor}/surface_triangles"]
    distance, normals = nearest_on_surface(vertices, triangles, point)
    cosine = np.clip(np.einsum("ni,nki->nk", direction, normals).max(axis=1), -1.0, 1.0)
    angle = float(np.degrees(np.arccos(cosine)).max())
    off = float(distance.max())
    yield Finding(
        sensor, "contact distance", f"{off * 1e6:.1f} um",
        f"<= {PAIRING_DISTANCE_M * 1e6:.0f} um", off <= PAIRING_DISTANCE_M,
    )  # fmt: skip
    yield Finding(
        sensor, "contact angle", f"{angle:.2f} deg",
        f"<= {PAIRING_ANGLE_DEG:g} deg", angle <= PAIRING_ANGLE_DEG,
    )  # fmt: skip


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
    normals = _vertex_normals(vertices, triangles)[triangles[near[row, best]]]
    smoothed = np.einsum("nk,nki->ni", _barycentric(nearest, closest[row, best]), normals)
    facet = np.cross(nearest[:, 1] - nearest[:, 0], nearest[:, 2] - nearest[:, 0])
    both = np.stack([smoothed, facet], axis=1)
    return distance[row, best], both / np.linalg.norm(both, axis=2, keepdims=True)


def _vertex_normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
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
