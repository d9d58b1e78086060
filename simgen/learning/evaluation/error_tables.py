"""Tables of errors on test samples, beside those that the ACROSS paper reports: table.md, metrics.json, metrics.csv."""

import csv
import io
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from simgen.dataset.atomic_files import put_in_place, write_aside
from simgen.errors import writing
from simgen.learning.data.registry import NETWORKS
from simgen.learning.data.samples import TrainingData
from simgen.learning.evaluation.contact import NEAR_MM
from simgen.learning.evaluation.doubt import LEVEL, Answers
from simgen.learning.evaluation.floor import Floor
from simgen.learning.evaluation.metrics import Errors, MeshErrors, SignalErrors, Statistic

# Root mean square errors of the paper's test samples: of meshes in um, of signals normalised.
SOURCE = "ACROSS, ICRA 2025 (arXiv:2411.08533)"
PUBLISHED = {spec.label: spec.published for spec in NETWORKS.values() if spec.published}
COLUMNS = {  # heading, digits
    "rmse_um": ("RMSE, um", 2),
    "region_rmse_um": ("RMSE in region, um", 2),
    "med_um": ("MED, um", 2),
    "region_med_um": ("MED in region, um", 2),
    "p99_um": ("p99, um", 1),
    "worst_um": ("worst, um", 1),
    "overlap": ("patch overlap", 3),
    "near": (f"within {NEAR_MM:g} mm", 1),
    "near_allowed": ("of those allowed", 1),
    "neighbours": ("samples with the same input", 2),
    "spread_mm": ("their contacts' largest distance, mm", 2),
    "contact_overlap": ("contact overlap", 3),
    "rmse": ("RMSE, normalised", 4),
}
ANSWERS = {
    "covered": (f"in the {LEVEL} % set", 1),
    "radius_mm": ("its radius, mm", 2),
    "energy_um": ("energy score, um", 2),
    "rmse_um": ("RMSE of the mean, um", 2),
    "likeliest_rmse_um": ("RMSE of the likeliest, um", 2),
    "near": (f"likeliest within {NEAR_MM:g} mm", 1),
    "near_of_2": ("best of 2", 1),
    "near_of_4": ("best of 4", 1),
    "contact_overlap": ("contact overlap", 3),
}
SHARES = ("near", "near_allowed", "covered", "near_of_2", "near_of_4")  # of samples, shown in %
FLOOR = "floor"
DEFINED_IN = {
    "region_rmse_um": "a deformation region", "overlap": "a contact patch",
    "near_allowed": "a contact that the floor allows to find",
}  # fmt: skip
ABSENT = "-"


@dataclass(frozen=True)
class Entry:
    """A model and its errors.

    task : inputs and outputs, such as "biotac mesh -> digit mesh"; models of one task are compared
    parameters : count of the numbers that it learned; None if there is none to tell
    baseline : True for models that networks have to beat
    published : the paper's network that it is compared with, a key of `PUBLISHED`
    labels : groups of samples, see `labels_of`
    answers : measures of its several answers; None for a model that gives one
    """

    task: str
    model: str
    errors: MeshErrors | SignalErrors | Floor
    parameters: int | None
    baseline: bool = False
    published: str | None = None
    labels: Mapping[str, np.ndarray] = field(default_factory=dict)
    answers: Answers | None = None

    @property
    def main_error(self) -> float:
        """Mean of the measure by which models are compared."""
        return self.errors.summary()[self.errors.MAIN].mean


def labels_of(data: TrainingData) -> dict[str, np.ndarray]:
    """Labels of samples, (sample,) each: ``indenter``, its name, and ``depth_mm``."""
    return {
        "indenter": np.array(data.dataset.indenters)[data.indenter],
        "depth_mm": np.round(data.depth * 1e3, 6),  # without the last digits of binary numbers
    }


def write_tables(folder: Path, entries: Sequence[Entry]) -> None:
    """Write table.md, metrics.json and metrics.csv into a folder, each whole or not at all.

    Raises `InputError` if they cannot be written.
    """
    texts = {"table.md": markdown(entries), "metrics.json": metrics_json(entries), "metrics.csv": metrics_csv(entries)}
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(dir=folder) as aside:
            put_in_place(folder, {name: write_aside(Path(aside), text.encode()) for name, text in texts.items()})


def by_task(entries: Sequence[Entry]) -> dict[str, list[Entry]]:
    """Entries of each task, in order."""
    return {task: [e for e in entries if e.task == task] for task in dict.fromkeys(entry.task for entry in entries)}


def best_baseline(entry: Entry, entries: Sequence[Entry]) -> Entry | None:
    """The best baseline of an entry's task, perhaps the entry itself; None if there is none."""
    baselines = [other for other in entries if other.baseline and other.task == entry.task]
    return min(baselines, key=lambda other: other.main_error, default=None)


def note(entry: Entry, entries: Sequence[Entry]) -> str:
    """Compare a model with the best baseline of its task, in words."""
    if isinstance(entry.errors, Floor):
        return "lower bound"
    best = best_baseline(entry, entries)
    if best is None or best is entry:
        return ""
    own, other = entry.main_error, best.main_error
    if not own < other:
        return f"worse than {best.model}" if own > other else f"no better than {best.model}"
    return f"{own / other:.2f} of {best.model}'s RMSE"


def count_samples(errors: Errors) -> str:
    """Count samples, and those in which each optional measure is defined: "9 samples, 5 with a contact patch."."""
    summary = errors.summary()
    known = {measure: summary[measure].samples for measure in DEFINED_IN if measure in summary}
    words = [f"{len(errors.rows):,} samples", *(f"{known[measure]:,} with {DEFINED_IN[measure]}" for measure in known)]
    return f"{', '.join(words)}."


def markdown(entries: Sequence[Entry]) -> str:
    """A page with a table for each task, and with one for each kind of group where there is a floor."""
    lines = ["# Errors on test samples", "", *_explanation(), ""]
    for task, own in by_task(entries).items():
        header, *rows = _cells(own)
        lines += [f"## {task}", "", count_samples(own[0].errors), ""]
        lines += [_row(header), _row(["---", *["---:"] * (len(header) - 2), "---"]), *map(_row, rows), ""]
        for floor in own:
            if isinstance(floor.errors, Floor):
                lines += [*_about(floor.errors), "", *_groups(floor, own)]
    several = [entry for entry in entries if entry.answers is not None]
    if several:
        lines += ["## Several answers", "", *_explanation_of_answers(), ""]
    for entry in several:
        lines += [f"### {entry.task}: {entry.model}", "", *_answers(entry), ""]
    return "\n".join(lines)


def metrics_json(entries: Sequence[Entry]) -> str:
    """All measures, over all samples and over each group; null where a measure is not defined."""
    found = {task: [plain_entry(entry, own) for entry in own] for task, own in by_task(entries).items()}
    whole = {"source_of_published": SOURCE, "published": PUBLISHED, "tasks": found}
    return json.dumps(whole, indent=1, allow_nan=False) + "\n"


def plain_entry(entry: Entry, entries: Sequence[Entry]) -> dict[str, Any]:
    """JSON values of an entry among those of its task."""
    return {
        "model": entry.model,
        "parameters": entry.parameters,
        "baseline": entry.baseline,
        "bar": entry is best_baseline(entry, entries),
        "published_as": entry.published,
        "note": note(entry, entries),
        **_plain_groups(entry.errors, entry.labels),
        "answers": None if entry.answers is None else _plain_groups(entry.answers, entry.labels),
    }


def metrics_csv(entries: Sequence[Entry]) -> str:
    """A line for each model and group of samples; empty cells where a measure is not defined."""
    statistics = [f"{measure}_{key}" for measure in COLUMNS for key in ("mean", "std", "samples")]
    text = io.StringIO()
    columns = ["task", "model", "parameters", "group", "value", *statistics]
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    for entry in entries:
        groups = [("all", "", entry.errors)]
        for name, labels in entry.labels.items():
            groups += [(name, label, errors) for label, errors in entry.errors.groups(labels).items()]
        for group, value, errors in groups:
            line = {"task": entry.task, "model": entry.model, "parameters": entry.parameters}
            plain = {f"{m}_{key}": each for m, of_m in _plain(errors).items() for key, each in of_m.items()}
            writer.writerow({**line, "group": group, "value": value, **plain})
    return text.getvalue()


def _plain_groups(errors: Errors, labels: Mapping[str, np.ndarray]) -> dict[str, dict]:
    """JSON values over all samples and over each group."""
    groups = {f"by_{name}": errors.groups(own) for name, own in labels.items()}
    plain = {name: {str(label): _plain(each) for label, each in own.items()} for name, own in groups.items()}
    return {"all": _plain(errors), **plain}


def _plain(errors: Errors) -> dict[str, dict[str, float | int | None]]:
    """JSON values: measure -> mean, std, samples."""
    return {
        measure: {key: value if math.isfinite(value) else None for key, value in asdict(statistic).items()}
        for measure, statistic in errors.summary().items()
    }


def _explanation() -> list[str]:
    return [
        "Mean ± standard deviation over samples. RMSE: root of the mean over all coordinates of a sample; MED: mean",
        "distance of its vertices; region: vertices at least 10 um from rest; p99, worst: of the distances of its",
        "vertices; patch overlap: intersection over union of the points within 50 um of the indenter's surface.",
        f"Within {NEAR_MM:g} mm: share of samples whose predicted contact has its centroid so near to the true one;",
        "of those allowed: the same among samples whose floor allows it. Floor: a lower bound of the error, and the",
        "contacts that can be found, where other presses give the same input within noise (docs/training.md).",
        f"Parameters: numbers that were learned. Rows as published: {SOURCE}, on its own data.",
    ]


def _explanation_of_answers() -> list[str]:
    return [
        f"Means over samples. In the {LEVEL} % set: share of samples whose set of places holds the true contact's",
        "centroid. Energy score: of all draws; that of a single answer is its RMSE. The mean: of all draws. Likeliest,",
        f"best of 2, best of 4: hypotheses, which are draws with contacts within {NEAR_MM:g} mm. Contact overlap:",
        "intersection over union of the likeliest's contact and the true one (docs/training.md).",
    ]


def _answers(entry: Entry) -> Iterator[str]:
    """Lines of the table of several answers."""
    yield _row(["", "samples", *(heading for heading, _ in ANSWERS.values())])
    yield _row(["---", *["---:"] * (len(ANSWERS) + 1)])
    groups = {"all": entry.answers}
    for name, labels in entry.labels.items():
        unit = name.partition("_")[2]
        groups |= {f"{label} {unit}".strip(): own for label, own in entry.answers.groups(labels).items()}
    for label, own in groups.items():
        summary = own.summary()
        cells = [_number(measure, summary[measure], spread=False) for measure in ANSWERS]
        yield _row([label, f"{len(own.rows):,}", *cells])


def _cells(entries: Sequence[Entry]) -> list[list[str]]:
    """Header and rows of one task; a published row stands below the network's own."""
    measures = [measure for measure in COLUMNS if measure in entries[0].errors.measures()]
    lines = [["model", *(COLUMNS[measure][0] for measure in measures), "parameters", "note"]]
    for entry in entries:
        summary = entry.errors.summary()
        numbers = [_number(measure, summary[measure]) if measure in summary else ABSENT for measure in measures]
        lines.append([entry.model, *numbers, _count(entry.parameters), note(entry, entries)])
        if entry.published is not None:
            stated = PUBLISHED[entry.published]
            numbers = [f"{stated[m]:.{COLUMNS[m][1]}f}" if m in stated else ABSENT for m in measures]
            lines.append([f"{entry.published} (ACROSS)", *numbers, ABSENT, "as published"])
    return lines


def _count(parameters: int | None) -> str:
    return ABSENT if parameters is None else f"{parameters:,}"


def _about(floor: Floor) -> list[str]:
    """Lines about the neighbours of samples."""
    shared = floor.neighbours > 0
    lines = [f"{np.count_nonzero(shared):,} samples have neighbours: samples of other presses with the same input."]
    if shared.any():
        spread = Statistic.of(floor.spread_mm[shared])
        apart = f", with contacts up to {spread.mean:.2f} mm apart" if spread.samples else ""
        lines.append(f"They have {floor.neighbours[shared].mean():.1f}{apart} (means).")
    overlap = Statistic.of(floor.contact_overlap)
    if overlap.samples:
        lines.append(f"Contacts that a network predicts overlap the true ones by {overlap.mean:.3f} at most (mean).")
    return lines


def _groups(floor: Entry, entries: Sequence[Entry]) -> Iterator[str]:
    """Lines of a table for each kind of group: the floor beside all models."""
    models = [floor, *(entry for entry in entries if entry is not floor)]
    for name, labels in floor.labels.items():
        yield f"RMSE in um, and contacts within {NEAR_MM:g} mm:"
        yield ""
        yield _row([name.replace("_", ", "), "samples", "neighbours", *(entry.model for entry in models)])
        yield _row(["---", *["---:"] * (len(models) + 2)])
        groups = [entry.errors.groups(labels) for entry in models]
        for label, own in groups[0].items():
            cells = [_short(each[label]) for each in groups]
            yield _row([str(label), f"{len(own.rows):,}", f"{own.neighbours.mean():.2f}", *cells])
        yield ""


def _short(errors: Errors) -> str:
    """The main error, and the share of contacts that are found: "24.00, 79.1 %"."""
    summary = errors.summary()
    cells = [_number(measure, summary[measure], spread=False) for measure in (errors.MAIN, "near")]
    return ", ".join(cell for cell in cells if cell != ABSENT)


def _number(measure: str, statistic: Statistic, spread: bool = True) -> str:
    """A mean; with its standard deviation if ``spread``, unless the measure is a share."""
    digits = (COLUMNS | ANSWERS)[measure][1]
    if not statistic.samples:
        return ABSENT
    if measure in SHARES:
        return f"{100.0 * statistic.mean:.{digits}f} %"
    if not spread:
        return f"{statistic.mean:.{digits}f}"
    return f"{statistic.mean:.{digits}f} ± {statistic.std:.{digits}f}"


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
