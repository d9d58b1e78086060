"""Run a plan: a task solves and writes some shards, and workers take one after the other.

No task depends on another, on the number of workers or on their order, so the dataset does not either.
"""

import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from simgen.config.job_schema import Job
from simgen.config.warp_device import check_device
from simgen.dataset.card import write_card
from simgen.dataset.growth import grow
from simgen.dataset.reader import Dataset
from simgen.dataset.writer import complete, filling, folder_aside, log_timing, open_or_create
from simgen.errors import NOT_WRITABLE, InputError, cannot_write
from simgen.pipeline.plan import Plan
from simgen.pipeline.shard import Presser, ShardReport, fem_presser, run_shards
from simgen.pipeline.shard_writer import Failure
from simgen.pipeline.workers import Workers

# In all tasks that a GPU's process solves at once, where these have several shards. They are many more than are under
# way at once, because a shard waits for its hardest press, and the others must keep the device busy. The host keeps
# their samples until their shard has ended: 2.5 MB for a press of the paired job, in single precision.
PRESSES_PER_GPU_PROCESS = 4608
SMALLER = 8  # times: a task that broke down is tried again in parts of which most may be sound


def run(
    plan: Plan,
    output: Path,
    workers: Workers | None = None,
    on_start: Callable[[int], Any] = lambda already: None,
    on_report: Callable[[ShardReport], Any] = lambda report: None,
    build: Callable[[Job, str, str], Presser] = fem_presser,
    again: Collection[int] = (),
) -> Dataset:
    """Fill a dataset: create it, go on with it or add trajectories to it, and solve every shard that is not finished.

    `workers` of `workers.start_workers`; None is this very process. `on_start` is told how many presses are
    there already, `on_report` what came of each shard. Finished shards that `again` names are solved once more. An
    interrupt closes the workers and leaves a dataset that the same call completes. A shard whose task raised, or ended
    its process, twice is left unfinished, and its report carries the error. Raises `InputError` if `output` holds
    another dataset, is being filled by another run, or cannot be written any more, and if the scheduler is lost.
    """
    if workers is None:
        check_device(plan.device)
        workers = Workers(plan.device)
    grow(output, plan.attributes, plan.arrays, plan.job)
    dataset = open_or_create(output, plan.attributes, plan.arrays, plan.job)
    if complete(dataset) and not again:
        on_start(dataset.presses)
        return dataset
    with filling(dataset):
        shards = sorted({*dataset.unfinished(), *again})
        on_start(dataset.presses - sum(len(dataset.shard_presses(shard)) for shard in shards))
        log_timing(dataset, {"began": time.time(), "shards": len(shards), "folder": str(plan.job.folder.resolve())})
        size = 1 if plan.device == "cpu" else shards_per_task(len(shards), plan.job, workers)
        try:
            for report in _reports(dataset, divide(shards, size), plan.job, workers, build):
                log_timing(dataset, {"finished": time.time(), **asdict(report)})
                on_report(report)
                if report.errno in NOT_WRITABLE:
                    raise InputError(cannot_write(output, report.errno))
        except BaseException:
            workers.close()
            raise
        if not dataset.unfinished():
            with folder_aside(dataset) as folder:
                write_card(dataset, folder)
    return dataset


def _reports(
    dataset: Dataset, parts: list[list[int]], job: Job, workers: Workers, build: Callable[[Job, str, str], Presser]
) -> Iterator[ShardReport]:
    """What came of all shards. Parts that broke down are tried once more, after the others and smaller.

    What shares a process with a task that kills it dies with it, so they are tried one at a time.
    """
    again = []
    for part, outcome in _solve(dataset, parts, job, workers, build):
        if isinstance(outcome, Failure) and not outcome.final:
            again += divide(part, max(1, len(part) // SMALLER))
        else:
            yield from _of_shards(dataset, part, outcome)
    for part in again:
        for _, outcome in _solve(dataset, [part], job, workers, build):
            yield from _of_shards(dataset, part, outcome)


def _solve(
    dataset: Dataset, parts: list[list[int]], job: Job, workers: Workers, build: Callable[[Job, str, str], Presser]
) -> Iterator[tuple[list[int], list[ShardReport] | Failure]]:
    """Parts as they are solved, and what came of each."""
    path = dataset.path.resolve()
    tasks = [(path, part, job, workers.device, build) for part in parts]
    for task, outcome in workers.map(_guarded, tasks):
        yield task[1], Failure.of(outcome) if isinstance(outcome, Exception) else outcome


def _guarded(arguments: tuple) -> list[ShardReport] | Failure:
    """Solve some shards; what goes wrong is data too."""
    try:
        return run_shards(*arguments)
    except Exception as error:
        failure = Failure.of(error)
        if failure.errno is not None and not str(getattr(error, "filename", "")).startswith(str(arguments[0])):
            return replace(failure, errno=None, final=False)  # a file of somebody else's
        return failure


def _of_shards(dataset: Dataset, part: list[int], outcome: list[ShardReport] | Failure) -> list[ShardReport]:
    if not isinstance(outcome, Failure):
        return outcome
    counts = {shard: len(dataset.shard_presses(shard)) for shard in part}
    return [ShardReport(shard, counts[shard], error=outcome.sentence, errno=outcome.errno) for shard in part]


def divide(shards: list[int], size: int) -> list[list[int]]:
    """Runs of at most ``size`` shards."""
    return [shards[first : first + size] for first in range(0, len(shards), size)]


def shards_per_task(shards: int, job: Job, workers: Workers) -> int:
    """As many as a GPU's task has room for, or fewer, so that all processes have the same number of tasks."""
    most = max(1, PRESSES_PER_GPU_PROCESS // (workers.tasks_at_once * job.dataset.presses_per_shard))
    rounds = max(1, -(-shards // (most * workers.count)))
    return max(1, -(-shards // (rounds * workers.count)))
