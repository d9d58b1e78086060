"""Console view of `simgen train`: a progress bar for each network, then tables of errors."""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from rich import box
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from simgen.cli.console import console, stop, tracked
from simgen.errors import InputError
from simgen.learning.data.schema import TrainingJob
from simgen.learning.evaluation.error_tables import ABSENT, PUBLISHED, Entry, best_baseline, by_task, count_samples
from simgen.learning.evaluation.floor import Floor
from simgen.learning.networks.checkpoint import NETWORK, read_sidecar
from simgen.learning.training.evaluate import FIGURE, evaluate
from simgen.learning.training.fit import Epoch
from simgen.learning.training.run import TrainingRun

SHORT = {  # heading, digits
    "rmse_um": ("RMSE", 2), "region_rmse_um": ("region", 1), "med_um": ("MED", 1), "p99_um": ("p99", 1),
    "overlap": ("overlap", 3), "rmse": ("RMSE", 4),
}  # fmt: skip


def train_with_progress(job: TrainingJob, output: Path, device: str, tensorboard: bool, tables: bool = True) -> None:
    """Train the networks that are not trained yet. With ``tables``, measure all, and write and print their errors."""
    try:
        run = TrainingRun(job, output, device, tracked)
        for name in job.in_order():
            _train(run, name, tensorboard)
        if not tables:
            return
        for table in console_tables(evaluate(run, tracked)):
            console.print(table)
    except torch.OutOfMemoryError:
        raise InputError(f"{device}: too little memory for this job; allowed: a smaller batch") from None
    except KeyboardInterrupt:
        stop(output)
    console.print(f"wrote {output / 'table.md'}, metrics.json, metrics.csv{f', {FIGURE}' * (output / FIGURE).exists()}")


def _train(run: TrainingRun, name: str, tensorboard: bool) -> None:
    if not run.is_trained(name):
        with _bar(name, run) as bar, _tensorboard(run.output / name, tensorboard) as write:
            for epoch in run.train(name):
                bar(epoch)
                write(epoch)
    file = run.output / name / NETWORK
    about = read_sidecar(file)
    try:
        console.print(f"[bold]{name}[/]  {_summary(about)}")
    except (LookupError, TypeError, ValueError) as error:
        raise InputError(f"{file.with_suffix('.json')}: not what `simgen train` wrote ({error})") from None


def _summary(about: Mapping[str, Any]) -> str:
    return (
        f"{about['parameters']:,} parameters, {about['epochs']} epochs in {about['seconds']:.1f} s, "
        f"{about['samples_per_second']:,.0f} samples/s; best epoch {about['best_epoch']}, "
        f"validation loss {about['best']['validation_loss']:.3g}"
    )


@contextmanager
def _bar(name: str, run: TrainingRun) -> Iterator[Any]:
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("epochs  {task.fields[loss]}"),
        TimeElapsedColumn(), TextColumn("at most"), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(name, total=run.job.fit_of(name).epochs, loss="")

        def show(epoch: Epoch) -> None:
            loss = f"loss {epoch.terms['train_loss']:.3g}, validation {epoch.terms['validation_loss']:.3g}"
            progress.update(task, completed=epoch.number + 1, loss=loss)

        yield show


@contextmanager
def _tensorboard(folder: Path, wanted: bool) -> Iterator[Any]:
    if not wanted:
        yield lambda epoch: None
        return
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ModuleNotFoundError:
        raise InputError("--tensorboard: tensorboard is not installed; allowed: pip install tensorboard") from None
    with SummaryWriter(str(folder)) as writer:

        def write(epoch: Epoch) -> None:
            for term, value in epoch.terms.items():
                writer.add_scalar(term, value, epoch.number)

        yield write


def console_tables(entries: Sequence[Entry]) -> Iterator[Table]:
    """Tables that fit into 80 columns, one for each task: means of the main measures, and a short note."""
    for task, own in by_task(entries).items():
        measures = [measure for measure in SHORT if measure in own[0].errors.measures()]
        unit = "um" if "rmse_um" in measures else "normalised"
        best = best_baseline(own[0], own)
        notes = [] if best is None else [f"Note: RMSE over that of {best.model}."]
        table = Table(
            "model", title=f"{task}, {unit}", caption=" ".join([f"Means over {count_samples(own[0].errors)}", *notes]),
            box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0),
        )  # fmt: skip
        for heading in (*(SHORT[measure][0] for measure in measures), "params"):
            table.add_column(heading, justify="right", no_wrap=True)
        table.add_column("note", no_wrap=True)
        for entry in own:
            means = {measure: statistic.mean for measure, statistic in entry.errors.summary().items()}
            table.add_row(entry.model, *_numbers(means, measures), _count(entry.parameters), _short_note(entry, best))
            if entry.published is not None:
                stated = _numbers(PUBLISHED[entry.published], measures)
                table.add_row(f"{entry.published} (ACROSS)", *stated, ABSENT, "published")
        yield table


def _numbers(means: Mapping[str, float], measures: Sequence[str]) -> list[str]:
    found = [(means.get(measure, math.nan), SHORT[measure][1]) for measure in measures]
    return [ABSENT if math.isnan(mean) else f"{mean:.{digits}f}" for mean, digits in found]


def _count(parameters: int | None) -> str:
    """A count in short form: 642, 81.3k, 1.2M."""
    if parameters is None:
        return ABSENT
    for size, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if parameters >= size:
            return f"{parameters / size:.1f}{letter}"
    return str(parameters)


def _short_note(entry: Entry, best: Entry | None) -> str:
    if isinstance(entry.errors, Floor):
        return "bound"
    if best is None or best is entry:
        return "" if best is None else "1.00"
    own, other = entry.main_error, best.main_error
    if not own < other:
        return f"{own / other:.3g} worse" if own > other > 0.0 else "no better"
    return f"{own / other:.2f}"
