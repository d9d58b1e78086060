"""How well models do on test samples, beside what the ACROSS paper reports: table.md, metrics.json, metrics.csv."""

import csv
import io
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich import box
from rich.table import Table

from simgen.dataset.atomic_files import put_in_place, write_aside
from simgen.errors import writing
from simgen.learning.training.data import TrainingData
from simgen.learning.training.metrics import Errors, MeshErrors, SignalErrors, Statistic

# Of its test samples, root mean square errors: of meshes in um, of signals normalised.
SOURCE = "ACROSS, ICRA 2025 (arXiv:2411.08533)"
PUBLISHED = {
    "S2MPN": {"rmse_um": 78.21, "region_rmse_um": 94.07},
    "MVB": {"rmse_um": 12.28, "region_rmse_um": 16.03},
    "MVD": {"rmse_um": 9.28, "region_rmse_um": 12.43},
    "M2MPN": {"rmse_um": 21.57, "region_rmse_um": 27.72},
    "SVB": {"rmse": 0.060},
}
COLUMNS = {  # heading, digits
    "rmse_um": ("RMSE, um", 2),
    "region_rmse_um": ("RMSE in region, um", 2),
    "med_um": ("MED, um", 2),
    "region_med_um": ("MED in region, um", 2),
    "p99_um": ("p99, um", 1),
    "worst_um": ("worst, um", 1),
    "overlap": ("patch overlap", 3),
    "rmse": ("RMSE, normalised", 4),
}
SHORT = {  # heading, digits on the console
    "rmse_um": ("RMSE", 2), "region_rmse_um": ("region", 1), "med_um": ("MED", 1), "p99_um": ("p99", 1),
    "overlap": ("overlap", 3), "rmse": ("RMSE", 4),
}  # fmt: skip
DEFINED_IN = {"region_rmse_um": "a deformation region", "overlap": "a contact patch"}
ABSENT = "-"


@dataclass(frozen=True)
class Entry:
    """A model and its errors.

    task : what is made of what, such as "biotac mesh -> digit mesh"; models of one task are compared
    baseline : whether it is there only to be beaten
    published : the network of the paper that it stands beside, a key of `PUBLISHED`
    labels : by what errors are grouped -> (sample,) of all samples of the data, see `labels_of`
    """

    task: str
    model: str
    errors: MeshErrors | SignalErrors
    parameters: int
    baseline: bool = False
    published: str | None = None
    labels: Mapping[str, np.ndarray] = field(default_factory=dict)


def labels_of(data: TrainingData) -> dict[str, np.ndarray]:
    """Of the samples of a dataset: names of indenters, and depths."""
    return {
        "indenter": np.array(data.dataset.indenters)[data.indenter],
        "depth_mm": np.round(data.depth * 1e3, 6),  # without the last digits of binary numbers
    }


def write_tables(folder: Path, entries: Sequence[Entry]) -> None:
    """Write table.md, metrics.json and metrics.csv into a folder, each whole or not at all.

    Raises `InputError` if it cannot be written.
    """
    texts = {"table.md": markdown(entries), "metrics.json": metrics_json(entries), "metrics.csv": metrics_csv(entries)}
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(dir=folder) as aside:
            put_in_place(folder, {name: write_aside(Path(aside), text.encode()) for name, text in texts.items()})


def note(entry: Entry, entries: Sequence[Entry]) -> str:
    """How a model compares with the bar of its task, which is the best of its baselines: no better is of no use."""
    bar = _bar(entry, entries)
    if bar is None or bar is entry:
        return ""
    own, other = _main(entry), _main(bar)
    if not own < other:
        return f"worse than {bar.model}" if own > other else f"no better than {bar.model}"
    return f"{own / other:.2f} of {bar.model}'s RMSE"


def markdown(entries: Sequence[Entry]) -> str:
    """A table for each task."""
    lines = ["# Errors on test samples", "", *_explanation(), ""]
    for task, own in _by_task(entries).items():
        header, *rows = _cells(own)
        lines += [f"## {task}", "", _samples(own[0].errors), ""]
        lines += [_row(header), _row(["---", *["---:"] * (len(header) - 2), "---"]), *map(_row, rows), ""]
    return "\n".join(lines)


def console_tables(entries: Sequence[Entry]) -> Iterator[Table]:
    """A table for each task that 80 columns hold: means of the main measures, and a short note."""
    for task, own in _by_task(entries).items():
        measures = [measure for measure in SHORT if measure in own[0].errors.measures()]
        unit = "um" if "rmse_um" in measures else "normalised"
        bar = _bar(own[0], own)
        bars = [] if bar is None else [f"Note: RMSE over that of {bar.model}."]
        table = Table(
            "model", title=f"{task}, {unit}", caption=" ".join([f"Means over {_samples(own[0].errors)}", *bars]),
            box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0),
        )  # fmt: skip
        for heading in (*(SHORT[measure][0] for measure in measures), "params"):
            table.add_column(heading, justify="right", no_wrap=True)
        table.add_column("note", no_wrap=True)
        for entry in own:
            means = {measure: statistic.mean for measure, statistic in entry.errors.summary().items()}
            table.add_row(entry.model, *_short(means, measures), _count(entry.parameters), _short_note(entry, own))
            if entry.published is not None:
                stated = _short(PUBLISHED[entry.published], measures)
                table.add_row(f"{entry.published} (ACROSS)", *stated, ABSENT, "published")
        yield table


def metrics_json(entries: Sequence[Entry]) -> str:
    """All measures, also of each group; null where a measure is not defined."""
    found = {
        task: [
            {
                "model": entry.model,
                "parameters": entry.parameters,
                "baseline": entry.baseline,
                "bar": entry is _bar(entry, own),
                "published_as": entry.published,
                "note": note(entry, own),
                "all": _plain(entry.errors),
                **{
                    f"by_{name}": {str(label): _plain(errors) for label, errors in entry.errors.groups(labels).items()}
                    for name, labels in entry.labels.items()
                },
            }
            for entry in own
        ]
        for task, own in _by_task(entries).items()
    }
    whole = {"source_of_published": SOURCE, "published": PUBLISHED, "tasks": found}
    return json.dumps(whole, indent=1, allow_nan=False) + "\n"


def metrics_csv(entries: Sequence[Entry]) -> str:
    """A line for each model and group; nothing where a measure is not defined."""
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


def _by_task(entries: Sequence[Entry]) -> dict[str, list[Entry]]:
    return {task: [e for e in entries if e.task == task] for task in dict.fromkeys(entry.task for entry in entries)}


def _plain(errors: Errors) -> dict[str, dict[str, float | int | None]]:
    """For JSON: measure -> mean, std, samples."""
    return {
        measure: {key: value if math.isfinite(value) else None for key, value in asdict(statistic).items()}
        for measure, statistic in errors.summary().items()
    }


def _explanation() -> list[str]:
    return [
        "Mean ± standard deviation over samples. RMSE: root of the mean over all coordinates of a sample; MED: mean",
        "distance of its vertices; region: vertices at least 10 um from rest; p99, worst: of the distances of its",
        "vertices; patch overlap: intersection over union of the points within 50 um of the indenter's surface.",
        f"Parameters: numbers that were learned. Rows as published: {SOURCE}, on its own data.",
    ]


def _samples(errors: Errors) -> str:
    """How many, and in how many of them what is not always defined is."""
    summary = errors.summary()
    known = {measure: summary[measure].samples for measure in DEFINED_IN if measure in summary}
    words = [f"{len(errors.rows):,} samples", *(f"{known[measure]:,} with {DEFINED_IN[measure]}" for measure in known)]
    return f"{', '.join(words)}."


def _cells(entries: Sequence[Entry]) -> list[list[str]]:
    """Of one task: the header and the rows, the paper's under those that they stand beside."""
    measures = [measure for measure in COLUMNS if measure in entries[0].errors.measures()]
    lines = [["model", *(COLUMNS[measure][0] for measure in measures), "parameters", "note"]]
    for entry in entries:
        summary = entry.errors.summary()
        numbers = [_number(summary[measure], COLUMNS[measure][1]) for measure in measures]
        lines.append([entry.model, *numbers, f"{entry.parameters:,}", note(entry, entries)])
        if entry.published is not None:
            stated = PUBLISHED[entry.published]
            numbers = [f"{stated[m]:.{COLUMNS[m][1]}f}" if m in stated else ABSENT for m in measures]
            lines.append([f"{entry.published} (ACROSS)", *numbers, ABSENT, "as published"])
    return lines


def _number(statistic: Statistic, digits: int) -> str:
    if not statistic.samples:
        return ABSENT
    return f"{statistic.mean:.{digits}f} ± {statistic.std:.{digits}f}"


def _count(parameters: int) -> str:
    """In three or four digits: 642, 81.3k, 1.2M."""
    for size, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if parameters >= size:
            return f"{parameters / size:.1f}{letter}"
    return str(parameters)


def _bar(entry: Entry, entries: Sequence[Entry]) -> Entry | None:
    """What a model is compared with: the best baseline of its task, which it may be itself; None if there is none."""
    baselines = [other for other in entries if other.baseline and other.task == entry.task]
    return min(baselines, key=_main, default=None)


def _main(entry: Entry) -> float:
    """The mean of what models are compared by."""
    return entry.errors.summary()[entry.errors.MAIN].mean


def _short(means: Mapping[str, float], measures: Sequence[str]) -> list[str]:
    found = [(means.get(measure, math.nan), SHORT[measure][1]) for measure in measures]
    return [ABSENT if math.isnan(mean) else f"{mean:.{digits}f}" for mean, digits in found]


def _short_note(entry: Entry, entries: Sequence[Entry]) -> str:
    bar = _bar(entry, entries)
    if bar is None or bar is entry:
        return "" if bar is None else "the bar"
    own, other = _main(entry), _main(bar)
    if not own < other:
        return f"{own / other:.3g} worse" if own > other > 0.0 else "no better"
    return f"{own / other:.2f}"


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
