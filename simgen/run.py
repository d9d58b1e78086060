"""Run a plan: a task solves and writes some shards, and workers take one after the other.

No task depends on another, on the number of workers or on their order, so the dataset does not either.
"""

import time
from collections.abc import Callable, Collection
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from simgen.dataset import Dataset
from simgen.dataset_writer import complete, filling, log_timing, open_or_create
from simgen.errors import NOT_WRITABLE, InputError, cannot_write
from simgen.job_schema import Job
from simgen.plan import Plan
from simgen.shard import Presser, ShardReport, fem_presser, run_shards
from simgen.shard_writer import Failure
from simgen.workers import Workers

# A task on a GPU: so many that the presses at its end, which leave the device idle, are few among them.
PRESSES_PER_GPU_TASK = 4096


def run(
    plan: Plan,
    output: Path,
    workers: Workers | None = None,
    on_start: Callable[[int], Any] = lambda already: None,
    on_report: Callable[[ShardReport], Any] = lambda report: None,
    build: Callable[[Job, str, str], Presser] = fem_presser,
    again: Collection[int] = (),
) -> Dataset:
    """Fill a dataset: create it or go on with it, and solve every shard that is not finished.

    `workers` of `simgen.workers.start_workers`; None is this very process. `on_start` is told how many presses are
    there already, `on_report` what came of each shard. Finished shards that `again` names are solved once more. An
    interrupt closes the workers and leaves a dataset that the same call completes. A shard whose task raised is left
    unfinished and its report carries the error. Raises `InputError` if `output` holds another dataset, is being filled
    by another run, or cannot be written any more.
    """
    workers = workers or Workers(plan.device)
    dataset = open_or_create(output, plan.attributes, plan.arrays, plan.job)
    if complete(dataset) and not again:
        on_start(dataset.presses)
        return dataset
    with filling(dataset):
        shards = sorted({*dataset.unfinished(), *again})
        on_start(dataset.presses - sum(len(dataset.shard_presses(shard)) for shard in shards))
        log_timing(dataset, {"began": time.time(), "shards": len(shards)})
        size = 1 if plan.device == "cpu" else shards_per_task(len(shards), plan.job, workers.count)
        tasks = [(output.resolve(), some, plan.job, workers.device, build) for some in divide(shards, size)]
        try:
            for reports in workers.map(_guarded, tasks):
                for report in reports:
                    log_timing(dataset, {"finished": time.time(), **asdict(report)})
                    on_report(report)
                    if report.errno in NOT_WRITABLE:
                        raise InputError(cannot_write(output, report.errno))
        except BaseException:
            workers.close()
            raise
    return dataset


def divide(shards: list[int], size: int) -> list[list[int]]:
    """Runs of at most ``size`` shards."""
    return [shards[first : first + size] for first in range(0, len(shards), size)]


def shards_per_task(shards: int, job: Job, gpus: int) -> int:
    """As many as a GPU's task has room for, or fewer, so that all GPUs have the same number of tasks."""
    most = max(1, PRESSES_PER_GPU_TASK // job.dataset.presses_per_shard)
    rounds = max(1, -(-shards // (most * gpus)))
    return max(1, -(-shards // (rounds * gpus)))


def _guarded(arguments: tuple) -> list[ShardReport]:
    """Run some shards; what goes wrong is data too."""
    try:
        return run_shards(*arguments)
    except Exception as error:
        path, shards = arguments[:2]
        counts = [len(Dataset(path).shard_presses(shard)) for shard in shards]
        failure = Failure.of(error)
        if not str(getattr(error, "filename", "")).startswith(str(path)):  # a file of somebody else's
            failure = replace(failure, errno=None)
        return [ShardReport(shard, count, error=failure.sentence, errno=failure.errno)
                for shard, count in zip(shards, counts, strict=True)]  # fmt: skip
