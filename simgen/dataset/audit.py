"""Audit of a dataset: is it whole, unchanged, converged and paired, and do vertices move only where they may?

The audit computes everything again from the stored arrays. It trusts only the certificates, which the solver alone can
compute. Shards whose checksums differ are reported and not read any further.
"""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from simgen.config.job_schema import hash_of
from simgen.config.outputs import Output
from simgen.dataset import touch_audit
from simgen.dataset.audit_finding import SHOWN, Finding, name, named, not_looked_at
from simgen.dataset.layout import faults
from simgen.dataset.reader import PLAN, Dataset, manifest_name
from simgen.dataset.splits import IN_NONE, SPLITS, number_presses, split_presses
from simgen.dataset.stored_arrays import NOT_REACHED, path_arrays
from simgen.dataset.touch_audit import DisplacementFaults
from simgen.errors import InputError
from simgen.fem.nonlinear.status import NOT_THERE, Status, has_values, is_planned_end
from simgen.units import UM_PER_M

FORCE_BALANCE = 1e-3  # limit, over the contact force
FLUID_VOLUME = 1e-6  # limit, over the cavity's volume


class ComparedFiles(NamedTuple):
    """Files of a manifest that were looked at, and the paths of those that have changed or are gone."""

    files: int
    changed: list[str]


class ShardAudit(NamedTuple):
    """Audit of one shard: its files, and the faults of its displacements by sensor."""

    files: ComparedFiles
    displacements: dict[str, DisplacementFaults]


def check(dataset: Dataset, known: Mapping[int, ShardAudit] | None = None) -> list[Finding]:
    """Audit a dataset: findings on the whole dataset, then on each sensor.

    known : shards that were looked at while the run went on, see `simgen.dataset.running_audit`
    """
    known = known or {}
    sums = _checksums(dataset, known)
    findings = [_presses(dataset), sums, _job(dataset)]
    if PLAN in sums.spoiled:  # all shards depend on the plan
        return findings
    layout = _layout(dataset)
    findings.append(layout)
    if layout.failed:
        return findings
    sound = SoundShards(dataset, {int(name.removesuffix(".json")) for name in sums.spoiled})
    findings += [_depths(sound), *([] if dataset.imported else [_numbering(sound)]), *_splits(sound)]
    for sensor in dataset.sensors:
        findings += [
            *(_imported(sound, sensor) if dataset.imported else _certificates(sound, sensor)),
            *touch_audit.displacements(sound, sensor, _of_sensor(known, sensor)),
            *touch_audit.pairing(sound, sensor),
        ]
    return findings


def _of_sensor(known: Mapping[int, ShardAudit], sensor: str) -> dict[int, DisplacementFaults]:
    return {shard: each.displacements[sensor] for shard, each in known.items() if not each.files.changed}


def passes(findings: list[Finding]) -> bool:
    return not any(finding.failed for finding in findings)


class SoundShards(Dataset):
    """A dataset that treats spoiled shards as unfinished."""

    def __init__(self, dataset: Dataset, spoiled: set[int]):
        super().__init__(dataset.path)
        self._spoiled = spoiled

    def finished(self) -> list[int]:
        return [shard for shard in super().finished() if shard not in self._spoiled]


def to_repair(dataset: Dataset, findings: Sequence[Finding]) -> list[int]:
    """Numbers of the shards to solve again: those with changed files or bad samples, and unfinished ones.

    Samples that did not converge are not bad: they would not converge again. Raises `InputError` if the plan has
    changed, or if the dataset was imported.
    """
    spoiled = {name for finding in findings for name in finding.spoiled}
    if dataset.imported and (spoiled or dataset.unfinished() or any(finding.bad for finding in findings)):
        raise InputError(f"{dataset.path}: what was imported cannot be solved again; import it anew")
    if PLAN in spoiled:
        raise InputError(f"{dataset.path}: its plan, which all presses share, has changed; run the job anew")
    per_shard = dataset.job.dataset.presses_per_shard
    bad = {press // per_shard for finding in findings for press, _ in finding.bad}
    return sorted({*bad, *dataset.unfinished(), *(int(name.removesuffix(".json")) for name in spoiled)})


def _presses(dataset: Dataset) -> Finding:
    missing = [press for shard in dataset.unfinished() for press in dataset.shard_presses(shard)]
    found = f"{dataset.presses - len(missing)} of {dataset.presses}"
    if missing:
        found += f", not {missing[0]}"
    return Finding("dataset", "presses", found, "all", not missing)


def _checksums(dataset: Dataset, known: Mapping[int, ShardAudit]) -> Finding:
    """Find manifests that are unreadable or incomplete, and files whose sha256 differs from their manifest's."""
    manifests = sorted({*dataset.manifests(), PLAN})
    seen = {manifest_name(shard): audit.files for shard, audit in known.items()}
    with ThreadPoolExecutor() as threads:
        found = list(threads.map(lambda each: seen.get(each) or compare_files(dataset, each), manifests))
    count, names = sum(each.files for each in found), sorted(file for each in found for file in each.changed)
    note = "changed or gone: " + "; ".join(names[:SHOWN]) if names else ""
    note += f"; and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    spoiled = tuple(manifest for manifest, each in zip(manifests, found, strict=True) if each.changed)
    return Finding("dataset", "checksums", f"{count - len(names)} of {count}", "all", not names, note, spoiled=spoiled)


def compare_files(dataset: Dataset, manifest: str) -> ComparedFiles:
    """Compare each file's sha256 with a manifest's. If the manifest is unreadable or incomplete, it has changed."""
    try:
        sums = dataset.sums_of(manifest)
    except InputError:
        sums = {}
    expected = _required_files(dataset, manifest)
    if not (sums.keys() >= expected if manifest == PLAN else sums.keys() == expected):
        return ComparedFiles(1, [f"manifest/{manifest}"])
    return ComparedFiles(len(sums), [file for file, total in sums.items() if _sha256(dataset, file) != total])


def _required_files(dataset: Dataset, manifest: str) -> set[str]:
    """The files that a manifest must list; the plan's may list more."""
    if manifest == PLAN:
        return {"zarr.json", "depth/c/0", *(f"{name}/zarr.json" for name in dataset.arrays)}
    return dataset.shard_files(int(manifest.removesuffix(".json")))


def _sha256(dataset: Dataset, file: str) -> str | None:
    path = dataset.path / file
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else None
    except (OSError, ValueError):  # a spoiled manifest can name anything
        return None


def _job(dataset: Dataset) -> Finding:
    found, expected = hash_of(dataset.attributes["job"]), dataset.attributes["job_hash"]
    return Finding("dataset", "job hash", found[:12], expected[:12], found == expected)


def _layout(dataset: Dataset) -> Finding:
    wrong = faults(dataset)
    total = f"{len(dataset.arrays)}"
    found = f"{len(wrong)} wrong" if wrong else total
    note = "; ".join(f"{name}: {fault}" for name, fault in list(wrong.items())[:SHOWN])
    return Finding("dataset", "arrays", found, "all", not wrong, note)


def _depths(dataset: Dataset) -> Finding:
    expected = path_arrays(dataset.indenter_path)
    wrong = [name for name, values in expected.items() if not np.array_equal(dataset[name], values)]
    what = "depths" if dataset.indenter_path.is_a_press else "steps of the path"
    return Finding("dataset", what, f"{len(dataset['depth'])}", "the job's", not wrong, ", ".join(wrong))


def _numbering(dataset: Dataset) -> Finding:
    """Compare trajectory, indenter and split of each press with the job's."""
    expected = dict(zip(("trajectory", "indenter"), number_presses(dataset.job), strict=True))
    expected["split"] = split_presses(dataset.job, dataset.grown_from)
    wrong = {name: np.flatnonzero(dataset[f"press/{name}"] != values) for name, values in expected.items()}
    note = "; ".join(f"{name}: press {presses[0]}" for name, presses in wrong.items() if len(presses))
    count = dataset.presses - len(np.unique(np.concatenate(list(wrong.values()))))
    return Finding("dataset", "numbering", f"{count} of {dataset.presses}", "the job's", not note, note)


def _splits(dataset: Dataset) -> Iterator[Finding]:
    trajectory, indenter, split = (dataset[f"press/{key}"] for key in ("trajectory", "indenter", "split"))
    counts = ", ".join(f"{name} {np.count_nonzero(split == code)}" for code, name in enumerate(SPLITS))
    used = split != IN_NONE
    pairs = np.unique(np.stack([trajectory, split])[:, used], axis=1)
    shared = np.flatnonzero(np.bincount(pairs[0]) > 1)
    note = f"in two splits: trajectories {', '.join(map(str, shared[:SHOWN]))}" if len(shared) else ""
    yield Finding("dataset", "splits", counts, "disjoint", not len(shared), note)
    if (left_out := dataset.job.dataset.leave_out) is not None:
        own = dataset.indenters.index(left_out)
        wrong = np.flatnonzero(used & ((split == list(SPLITS).index("test")) != (indenter == own)))
        note = f"in the wrong split: presses {', '.join(map(str, wrong[:SHOWN]))}" if len(wrong) else ""
        yield Finding("dataset", "left out", left_out, "in test alone", not len(wrong), note)


def _imported(dataset: Dataset, sensor: str) -> Iterator[Finding]:
    """Count the samples of an imported dataset; its files do not say if they converged."""
    status = dataset[f"{sensor}/status"]
    there = has_values(status)
    found = f"{np.count_nonzero(there)} of {there.size}"
    yield Finding(sensor, "samples in the files", found, "stated", None, _sentences(dataset, status, ~there))
    yield not_looked_at(sensor, "certificates", "the files that were imported hold none")


def _certificates(dataset: Dataset, sensor: str) -> Iterator[Finding]:
    status = dataset[f"{sensor}/status"]
    converged = has_values(status)
    yield from _outcomes(dataset, sensor, status)
    limits = [
        ("residual", "residual", dataset.job.solver.residual_tolerance),
        ("contact_error", "contact error", dataset.job.solver.contact_tolerance),
        ("force_balance", "force balance", FORCE_BALANCE),
    ]
    if dataset.job.sensors[sensor].fluid != "none":
        limits.append(("liquid_volume_error", "fluid volume, change", FLUID_VOLUME))
    for key, what, limit in limits:
        yield named(sensor, what, dataset[f"{sensor}/certificate/{key}"], limit, "{:.2e}", of=converged)

    def stored(key: str) -> np.ndarray:
        return dataset[f"{sensor}/certificate/{key}"]

    for output in dataset.job.kept_outputs(sensor):
        if output.is_estimate:
            yield estimated_error(sensor, output, dataset[f"{sensor}/{output.name}"][converged])
        elif output.is_sensor_value or output.at_surface or output.is_image:
            finite = _finite(dataset, f"{sensor}/{output.name}", output.is_read_by_sample, converged.shape)
            yield named(sensor, f"{output.name} gaps", ~finite & converged, 0.0, "{:.0f}", total=True)
    least = stored("least_det_F" if f"{sensor}/certificate/least_det_F" in dataset.arrays else "min_det_F")
    valid = dataset[f"{sensor}/status"] == Status.CONVERGED
    bad = tuple((int(press), int(depth)) for press, depth in np.argwhere(valid & ~(least > 0)))
    found = f"{np.min(least, initial=np.inf, where=valid):.3f}"
    yield Finding(sensor, "det F, least", found, "> 0", not bad, name("det F", bad), bad)
    yield _inverted(sensor, np.where(converged, stored("inverted_elements"), 0), np.count_nonzero(converged))
    rms, deepest = (
        np.max(stored(f"{each}_penetration_m"), initial=0.0, where=converged) * 1e6 for each in ("rms", "max")
    )
    yield Finding(sensor, "penetration", f"rms {rms:.1f}, max {deepest:.1f} um", "stated", None)


def estimated_error(sensor: str, output: Output, values: np.ndarray) -> Finding:
    """State the estimated errors (n,) of the converged samples; they are no ground to fail a dataset."""
    known = np.abs(values[np.isfinite(values)]) * (UM_PER_M if output.unit == "m" else 100.0)
    unit, what = "um" if output.unit == "m" else "%", output.name.partition("_error")[0]
    found = f"median {np.median(known):.1f}, worst {known.max():.1f} {unit}" if len(known) else "none"
    if len(known) < len(values):
        found += f"; {len(values) - len(known)} samples without"
    return Finding(sensor, f"{what}, estimated error", found, "stated", None)


def _finite(dataset: Dataset, name: str, by_shard: bool, shape: tuple[int, int]) -> np.ndarray:
    """Samples (press, depth) with finite numbers only. Large arrays are read shard by shard."""
    if not by_shard:
        return np.isfinite(dataset[name]).reshape(*shape, -1).all(axis=2)
    finite = np.ones(shape, dtype=bool)
    for shard in dataset.finished():
        presses = dataset.shard_presses(shard)
        rows = slice(presses.start, presses.stop)
        stored = dataset.of_samples(name, rows)
        known = stored != NOT_REACHED if stored.dtype == np.int16 else np.isfinite(stored)
        finite[rows] = known.all(axis=(2, 3))
    return finite


def _outcomes(dataset: Dataset, sensor: str, status: np.ndarray) -> Iterator[Finding]:
    """Count converged samples among those that were to be pressed, and samples that ended as planned."""
    planned, converged = is_planned_end(status), has_values(status)
    missed = ~(planned | converged)
    found, note = f"{np.count_nonzero(converged)} of {np.count_nonzero(~planned)}", _sentences(dataset, status, missed)
    yield Finding(sensor, "samples converged", found, "all", not missed.any(), note, listed=_first_of_presses(missed))
    if planned.any():
        found, note = f"{np.count_nonzero(planned)} of {status.size}", _sentences(dataset, status, planned)
        yield Finding(sensor, "not pressed, as planned", found, "stated", None, note, listed=_first_of_presses(planned))


def _inverted(sensor: str, elements: np.ndarray, converged: int) -> Finding:
    """List converged samples with inverted elements, by press; ``elements`` (press, depth) counts these."""
    samples = np.argwhere(elements > 0)
    presses, first, counts = np.unique(samples[:, 0], return_index=True, return_counts=True)
    lines = [f"press {press}, {count} from depth {depth} on, in at most {elements[press].max()} elements"
             for press, depth, count in zip(presses, samples[first, 1], counts, strict=True)]  # fmt: skip
    note = "inverted: " + "; ".join(lines[:SHOWN]) if lines else ""
    note += f"; and {len(lines) - SHOWN} more presses" if len(lines) > SHOWN else ""
    found, listed = f"{len(samples)} of {converged}", tuple((int(press), int(depth)) for press, depth in samples)
    return Finding(sensor, "of these inverted", found, "stated", None, note, listed=listed)


def _first_of_presses(samples: np.ndarray) -> tuple[tuple[int, int], ...]:
    """The first marked sample of each press; samples (press, depth) bool."""
    presses = np.flatnonzero(samples.any(axis=1))
    return tuple((int(press), int(samples[press].argmax())) for press in presses)


def _sentences(dataset: Dataset, status: np.ndarray, of: np.ndarray) -> str:
    """One line for each status among the samples ``of`` (press, depth) bool."""
    lines = []
    for code in np.unique(status[of]):
        press, depth = np.argwhere(status == code)[0]
        count = np.count_nonzero(status == code)
        words = dataset.sentence(code) if code != NOT_THERE else "Not there yet, or in a file that has changed."
        lines.append(f"{count} samples, the first at press {press}, depth {depth}: {words}")
    return "\n".join(lines)
