"""Run a plan: one task solves and writes one shard, and dask hands them out. Only this file imports dask.

No task depends on another, on the number of workers or on their order, so the dataset does not either.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from simgen.dataset import Dataset, finish, log_timing, open_or_create
from simgen.job import Job
from simgen.plan import Plan
from simgen.shard import Presser, ShardReport, fem_presser, run_shard, warm_up

TASKS_PER_WORKER = 2  # submitted and not finished: one runs, one waits

# A terminal interrupts the whole process group; only the parent should answer, and end the workers itself.
IGNORE_INTERRUPTS = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"


def run(
    plan: Plan,
    output: Path,
    workers: int | None = None,
    scheduler: str | None = None,
    on_start: Callable[[int], Any] = lambda already: None,
    on_report: Callable[[ShardReport], Any] = lambda report: None,
    build: Callable[[Job, str, str], Presser] = fem_presser,
) -> Dataset:
    """Fill a dataset: create it or go on with it, and solve every shard that is not finished.

    `scheduler`: None for a local cluster of `workers` processes (default: one per core, or one for a GPU), an
    address of a dask scheduler that sees the same file system, or "sync" for this very process.
    `on_start` is told how many presses are there already, `on_report` what came of each task.
    An interrupt leaves a dataset that the same call completes. A shard whose task raised is left unfinished
    and its report carries the error. Raises `InputError` if `output` holds another dataset.
    """
    dataset = open_or_create(output, plan.attributes, plan.arrays, plan.job)
    shards = dataset.unfinished()
    if shards and scheduler != "sync":
        warm_up(plan, build)  # once, here, instead of in every worker at the same time
    with _executor(workers, scheduler, plan.device, len(shards)) as execute:
        on_start(sum(len(dataset.shard_presses(shard)) for shard in dataset.finished()))
        for report in execute([(output.resolve(), shard, plan.job, plan.device, build) for shard in shards]):
            log_timing(dataset, {"finished": time.time(), **asdict(report)})
            on_report(report)
    finish(dataset)
    return dataset


def _guarded(arguments: tuple) -> ShardReport:
    """Run one shard; what goes wrong is data too."""
    try:
        return run_shard(*arguments)
    except Exception as error:
        path, shard = arguments[:2]
        count = len(Dataset(path).shard_presses(shard))
        return ShardReport(shard, count, error=f"{type(error).__name__}: {error}")


@contextmanager
def _executor(workers: int | None, scheduler: str | None, device: str, tasks: int) -> Iterator[Callable]:
    """A function that runs `_guarded` on a list of arguments and yields the reports as they come."""
    if scheduler == "sync" or tasks == 0:
        yield lambda arguments: map(_guarded, arguments)
        return
    from dask.distributed import Client, LocalCluster

    if scheduler is not None:
        with Client(scheduler) as client:
            yield lambda arguments: _submit(client, arguments)
        return
    cores = workers or (_cores() if device == "cpu" else 1)
    options = {
        "n_workers": min(cores, tasks),
        "threads_per_worker": 1,
        "dashboard_address": None,
        "silence_logs": "CRITICAL",
        "preload": [IGNORE_INTERRUPTS],
    }
    with LocalCluster(**options) as cluster, Client(cluster) as client:
        yield lambda arguments: _submit(client, arguments)


def _submit(client, arguments: list[tuple]) -> Iterator[ShardReport]:
    """Keep a bounded number of tasks submitted, so that a long job stays light on the scheduler."""
    from dask.distributed import as_completed

    waiting = iter(arguments)
    bound = TASKS_PER_WORKER * max(1, sum(client.nthreads().values()))
    futures = as_completed(
        [client.submit(_guarded, next(waiting), pure=False) for _ in range(min(bound, len(arguments)))]
    )
    for future in futures:
        yield future.result()
        for argument in waiting:
            futures.add(client.submit(_guarded, argument, pure=False))
            break


def _cores() -> int:
    from dask.system import CPU_COUNT  # respects cgroup limits and affinity

    return CPU_COUNT
