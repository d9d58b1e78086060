"""Console view of `simgen train`: a progress bar for each network, then the table of errors."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from simgen.cli.console import console, stop, tracked
from simgen.errors import InputError
from simgen.learning.training.checkpoint import NETWORK, read_sidecar
from simgen.learning.training.evaluation import FIGURE, evaluate
from simgen.learning.training.fit import Epoch
from simgen.learning.training.run import TrainingRun
from simgen.learning.training.schema import TrainingJob
from simgen.learning.training.table import console_tables


def train_with_progress(job: TrainingJob, output: Path, device: str, tensorboard: bool) -> None:
    """Train the networks that are not trained yet, measure all, and write and print the table of errors."""
    try:
        run = TrainingRun(job, output, device, tracked)
        for name in job.in_order():
            _train(run, name, tensorboard)
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
