"""Arguments and options that several commands share, and the defaults and checks that belong to them."""

import re
from pathlib import Path
from typing import Annotated

import typer

from simgen.errors import InputError, shown

DatasetFolder = Annotated[Path, typer.Argument(metavar="DATASET", help="A dataset folder, as `simgen run` writes it.")]
Device = Annotated[str, typer.Option("--device", metavar="DEVICE", help="cpu, cuda or cuda:N.")]
Workers = Annotated[
    int | None,
    typer.Option(min=1, help="Number of local processes. With a scheduler: wait for this many workers.",
                 show_default="one per core or GPU"),
]  # fmt: skip
Processes = Annotated[
    int | None, typer.Option("--workers", min=1, help="Number of processes.", show_default="one per core, or one GPU")
]
Scheduler = Annotated[
    str | None,
    typer.Option(help="Address of a dask scheduler, or `sync` to solve in this process.", show_default="local cluster"),
]
SchedulerFile = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="File written by `dask scheduler --scheduler-file`; replaces --scheduler."),
]
Trajectories = Annotated[
    str | None, typer.Option(help="Trajectory numbers: 0:10 (end excluded) or 3,7.", show_default="all")
]
Split = Annotated[str | None, typer.Option(help="train, validation or test.", show_default="all")]


def named_after(dataset: Path, suffix: str) -> Path:
    """Default output of a command, in the current folder: the dataset's name with another suffix."""
    return Path(f"{dataset.resolve().name.removesuffix('.zarr')}{suffix}")


def process_count(workers: int | None, device: str) -> int:
    """The given number, else one process per core, or one for a GPU."""
    from simgen.pipeline.workers import cores

    return workers or (cores() if device == "cpu" else 1)


def scheduler_address(scheduler: str | None, file: Path | None) -> str | None:
    """Address of the scheduler, from one of the two options. Raises `InputError` if both are given."""
    if file is None:
        return scheduler
    if scheduler is not None:
        raise InputError(f"--scheduler {scheduler} and --scheduler-file {file}: allowed: one of them")
    from simgen.pipeline import workers

    return workers.scheduler_address(file)


def height_and_width(size: str | None) -> tuple[int | None, int | None]:
    """Pixels of ``--size WIDTHxHEIGHT``. Raises `InputError` for other text."""
    if size is None:
        return None, None
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", size)
    if match is None:
        raise InputError(f"--size {size!r}: write it as WIDTHxHEIGHT, such as 480x640")
    return int(match[2]), int(match[1])


def smoothing(blur: str | None, no_blur: bool) -> str | None:
    """Kind of smoothing, "auto" by default, None for none. Raises `InputError` if both options are given."""
    if not no_blur:
        return blur or "auto"
    if blur is not None:
        raise InputError(f"--no-blur: contradicts --blur {shown(blur)}; allowed: one of them")
    return None


def sample_range(samples: str | None) -> range | None:
    """Numbers of ``--samples FIRST:END``. Raises `InputError` for other text or an empty range."""
    if samples is None:
        return None
    match = re.fullmatch(r"(\d{1,9}):(\d{1,9})", samples)
    if match is None or int(match[1]) >= int(match[2]):
        raise InputError(f"--samples {samples!r}: write it as 0:200 (the end excluded)")
    return range(int(match[1]), int(match[2]))
