"""Audit of a dataset: is it whole, unchanged, converged, paired, held and touched where it should be?

All is computed again from what is stored; what the run said about itself is not believed, except for the
certificates, which the solver alone can know. Shards whose files have changed are told by their checksums, and are
looked at no further: what they hold might not even be read.
"""

import hashlib
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from simgen import touch_audit
from simgen.dataset import SPLITS, Dataset
from simgen.errors import InputError
from simgen.finding import SHOWN, Finding, name, named

FORCE_BALANCE = 1e-3  # of the contact force
LIQUID_VOLUME = 1e-6  # of the cavity's volume
PLAN = "plan"


def check(dataset: Dataset) -> list[Finding]:
    """All findings, the whole dataset first, then each sensor."""
    checksums = _checksums(dataset)
    spoiled = spoiled_shards(dataset, checksums.files)
    findings = [_presses(dataset), checksums, _job(dataset)]
    if None in spoiled:  # what all shards share: nothing else means anything
        return findings
    sound = Sound(dataset, spoiled)
    findings += [*_layout(sound), *_splits(sound)]
    for sensor in dataset.sensors:
        findings += [
            *_certificates(sound, sensor),
            *touch_audit.displacements(sound, sensor),
            *touch_audit.pairing(sound, sensor),
        ]
    return findings


def passes(findings: list[Finding]) -> bool:
    return not any(finding.failed for finding in findings)


class Sound(Dataset):
    """A dataset of which some shards are as if they were not there."""

    def __init__(self, dataset: Dataset, spoiled: set[int]):
        super().__init__(dataset.path)
        self._spoiled = spoiled

    def finished(self) -> list[int]:
        return [shard for shard in super().finished() if shard not in self._spoiled]

    def __getitem__(self, path: str) -> np.ndarray:
        array = self.arrays.get(path)
        if not self._spoiled or array is None:
            return super().__getitem__(path)
        values = np.full((self.presses, *array.shape), array.fill, array.dtype)
        for shard in self.finished():
            rows = self.shard_presses(shard)
            values[rows.start : rows.stop] = self.root[path][rows.start : rows.stop]
        return values


def to_repair(dataset: Dataset, findings: Sequence[Finding]) -> list[int]:
    """Shards that would be sound if they were solved again: those with bad samples, changed files, or not there yet.

    Samples that did not converge are none: they would not converge again. Raises `InputError` if what all shards share
    has changed.
    """
    files = [file for finding in findings for file in finding.files]
    shards = spoiled_shards(dataset, files) | set(dataset.unfinished())
    if None in shards:
        file = next(file for file in files if spoiled_shards(dataset, [file]) == {None})
        raise InputError(f"{dataset.path}/{file}: belongs to the plan, which all presses share; run the job anew")
    per_shard = dataset.job.dataset.presses_per_shard
    return sorted(shards | {press // per_shard for finding in findings for press, _ in finding.bad})


def spoiled_shards(dataset: Dataset, files: Sequence[str]) -> set[int | None]:
    """Which shards some files belong to; None stands for the plan, which all share."""
    shards = set()
    for file in files:
        array, _, key = file.rpartition("/c/")
        if file.startswith("manifest/"):
            shards.add(None if PLAN in file else int(file.removeprefix("manifest/").removesuffix(".json")))
        else:
            shards.add(int(key.split("/")[0]) if array in dataset.arrays else None)
    return shards


def _presses(dataset: Dataset) -> Finding:
    missing = [press for shard in dataset.unfinished() for press in dataset.shard_presses(shard)]
    found = f"{dataset.presses - len(missing)} of {dataset.presses}"
    if missing:
        found += f", not {missing[0]}"
    return Finding("dataset", "presses", found, "all", not missing)


def _checksums(dataset: Dataset) -> Finding:
    """Files that are not what their manifest says, by path, manifests that cannot be read among them."""
    sums, wrong = {}, []
    for manifest in dataset.manifests():
        try:
            sums |= dataset.sums_of(manifest)
        except InputError:
            wrong.append(f"manifest/{manifest}")
    with ThreadPoolExecutor() as threads:
        found_sums = threads.map(lambda file: _sha256(dataset, file), sums)
        wrong += [file for file, found in zip(sums, found_sums, strict=True) if found != sums[file]]
    count = len(sums) + sum(file.startswith("manifest/") for file in wrong)
    note = ""
    if wrong:
        note = "changed or gone: " + "; ".join(wrong[:SHOWN])
        note += f"; and {len(wrong) - SHOWN} more" if len(wrong) > SHOWN else ""
    found = f"{count - len(wrong)} of {count}"
    return Finding("dataset", "checksums", found, "all", not wrong, note, files=tuple(wrong))


def _sha256(dataset: Dataset, file: str) -> str | None:
    try:
        return hashlib.sha256((dataset.path / file).read_bytes()).hexdigest()
    except OSError:
        return None


def _job(dataset: Dataset) -> Finding:
    same = dataset.job.hash == dataset.attributes["job_hash"]
    return Finding("dataset", "job hash", dataset.job.hash[:12], dataset.attributes["job_hash"][:12], same)


def _layout(dataset: Dataset) -> Iterator[Finding]:
    wrong = []
    for path, array in dataset.arrays.items():
        stored = dataset.root.get(path)
        shape = (dataset.presses, *array.shape)
        if stored is None or stored.shape != shape or stored.dtype != array.dtype:
            wrong.append(path)
    found = f"{len(dataset.arrays) - len(wrong)} of {len(dataset.arrays)}" + (
        f", not {wrong[0]}" if wrong else ""
    )
    yield Finding("dataset", "array shapes", found, "all", not wrong)
    same = np.array_equal(dataset["depth"], dataset.job.depths_m)
    yield Finding("dataset", "depths", f"{len(dataset['depth'])}", "the job's", same)


def _splits(dataset: Dataset) -> Iterator[Finding]:
    trajectory, split = dataset["press/trajectory"], dataset["press/split"]
    pairs = np.unique(np.stack([trajectory, split]), axis=1)
    of_trajectory = np.bincount(pairs[0])
    counts = np.bincount(pairs[1], minlength=len(SPLITS))
    shown = " / ".join(str(count) for count in counts)
    shared = np.flatnonzero(of_trajectory > 1)
    note = f"in two splits: trajectories {', '.join(map(str, shared[:SHOWN]))}" if len(shared) else ""
    yield Finding("dataset", "splits", shown, "disjoint", not len(shared), note)


def _certificates(dataset: Dataset, sensor: str) -> Iterator[Finding]:
    status = dataset[f"{sensor}/status"]
    converged = status == 0
    found = f"{np.count_nonzero(converged)} of {status.size}"
    yield Finding(
        sensor, "samples converged", found, "all", bool(converged.all()), _failures(dataset, status)
    )
    limits = [
        ("residual", "residual", dataset.job.solver.residual_tolerance),
        ("contact_error", "contact error", dataset.job.solver.contact_tolerance),
        ("force_balance", "force balance", FORCE_BALANCE),
    ]
    if dataset.job.sensors[sensor].fluid != "none":
        limits.append(("liquid_volume_error", "liquid volume, change", LIQUID_VOLUME))
    for key, what, limit in limits:
        yield named(sensor, what, dataset[f"{sensor}/certificate/{key}"], limit, "{:.2e}", of=converged)

    def stored(key: str) -> np.ndarray:
        return dataset[f"{sensor}/certificate/{key}"]

    least = stored("min_det_F")
    bad = tuple((int(press), int(depth)) for press, depth in np.argwhere(converged & ~(least > 0)))
    found = f"{np.min(least, initial=np.inf, where=converged):.3f}"
    yield Finding(sensor, "det F, least", found, "> 0", not bad, name("det F", bad), bad)
    inverted = np.max(stored("inverted_elements"), initial=0, where=converged)
    yield Finding(sensor, "elements inverted in part", f"{inverted} at most", "stated", None)
    rms, deepest = (
        np.max(stored(f"{each}_penetration_m"), initial=0.0, where=converged) * 1e6 for each in ("rms", "max")
    )
    yield Finding(sensor, "penetration", f"rms {rms:.1f}, max {deepest:.1f} um", "stated", None)


def _failures(dataset: Dataset, status: np.ndarray) -> str:
    """What befell the samples that did not converge, one line for each status."""
    sentences = {**dataset.attributes["status"], "-1": "Not there yet, or in a file that has changed."}
    lines = []
    for code in np.unique(status[status != 0]):
        press, depth = np.argwhere(status == code)[0]
        count = np.count_nonzero(status == code)
        lines.append(f"{count} samples, the first at press {press}, depth {depth}: {sentences[str(code)]}")
    return "\n".join(lines)
