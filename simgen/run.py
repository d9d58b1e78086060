"""Run a plan: a task solves and writes some shards, and dask hands the tasks out. Only this file imports dask.

No task depends on another, on the number of workers or on their order, so the dataset does not either.
"""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from simgen.dataset import Dataset, finish, log_timing, open_or_create
from simgen.job import Job
from simgen.plan import Plan
from simgen.shard import Presser, ShardReport, fem_presser, run_shards

TASKS_PER_WORKER = 2  # submitted and not finished: one runs, one waits
# A task on a GPU: so many that the presses at its end, which leave the device idle, are few among them.
PRESSES_PER_GPU_TASK = 4096

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

    `scheduler`: None for a local cluster of `workers` processes (default: one per core, or one per GPU), an
    address of a dask scheduler that sees the same file system, or "sync" for this very process.
    `on_start` is told how many presses are there already, `on_report` what came of each shard.
    An interrupt leaves a dataset that the same call completes. A shard whose task raised is left unfinished
    and its report carries the error. Raises `InputError` if `output` holds another dataset.
    """
    dataset = open_or_create(output, plan.attributes, plan.arrays, plan.job)
    shards = dataset.unfinished()
    gpus = visible_gpus(plan.device) if plan.device != "cpu" and scheduler is None else []
    try:
        with _executor(workers, scheduler, gpus, len(shards)) as (execute, at_once):
            on_start(sum(len(dataset.shard_presses(shard)) for shard in dataset.finished()))
            tasks = divide(shards, 1 if plan.device == "cpu" else shards_per_task(len(shards), plan.job, at_once))
            device = "cuda" if gpus else plan.device  # a worker sees its own GPU and no other
            for reports in execute([(output.resolve(), some, plan.job, device, build) for some in tasks]):
                for report in reports:
                    log_timing(dataset, {"finished": time.time(), **asdict(report)})
                    on_report(report)
    except BaseException:
        if scheduler in (None, "sync"):  # tasks of a scheduler elsewhere may still be writing
            finish(dataset)
        raise
    finish(dataset)
    return dataset


def divide(shards: list[int], size: int) -> list[list[int]]:
    """Runs of at most ``size`` shards."""
    return [shards[first : first + size] for first in range(0, len(shards), size)]


def shards_per_task(shards: int, job: Job, gpus: int) -> int:
    """As many as a GPU's task has room for, or fewer, so that all GPUs have the same number of tasks."""
    most = max(1, PRESSES_PER_GPU_TASK // job.dataset.presses_per_shard)
    rounds = max(1, -(-shards // (most * gpus)))
    return max(1, -(-shards // (rounds * gpus)))


def visible_gpus(device: str) -> list[str]:
    """What CUDA_VISIBLE_DEVICES calls the GPUs of ``cuda`` (all that are visible here) or ``cuda:N``."""
    import warp as wp

    names = os.environ.get("CUDA_VISIBLE_DEVICES")
    names = names.split(",") if names else [str(i) for i in range(wp.get_cuda_device_count())]
    number = device.partition(":")[2]
    return [names[int(number)]] if number else names


def _guarded(arguments: tuple) -> list[ShardReport]:
    """Run some shards; what goes wrong is data too."""
    try:
        return run_shards(*arguments)
    except Exception as error:
        path, shards = arguments[:2]
        counts = [len(Dataset(path).shard_presses(shard)) for shard in shards]
        message = f"{type(error).__name__}: {error}"
        return [ShardReport(shard, count, error=message) for shard, count in zip(shards, counts, strict=True)]


@contextmanager
def _executor(
    workers: int | None, scheduler: str | None, gpus: list[str], shards: int
) -> Iterator[tuple[Callable, int]]:
    """A function that runs `_guarded` on a list of arguments and yields the reports as they come; and its workers."""
    if scheduler == "sync" or shards == 0:
        yield lambda arguments: map(_guarded, arguments), 1
        return
    from dask.distributed import Client

    if scheduler is not None:
        with Client(scheduler) as client:
            yield lambda arguments: _submit(client, arguments), max(1, len(client.nthreads()))
        return
    environments = [{"CUDA_VISIBLE_DEVICES": gpu} for gpu in gpus] or [{}] * (workers or _cores())
    environments = environments[: min(workers or shards, shards)]
    with local_cluster(environments) as cluster, Client(cluster) as client:
        yield lambda arguments: _submit(client, arguments), len(environments)


def local_cluster(environments: list[dict[str, str]]):
    """A dask cluster on this machine: a process for each environment, which it keeps when it is started again.

    A process with a GPU of its own has a second thread, which writes while the first one solves.
    """
    from dask.distributed import Nanny, Scheduler, SpecCluster
    from distributed.system import MEMORY_LIMIT

    shared = {"preload": [IGNORE_INTERRUPTS], "silence_logs": "CRITICAL", "dashboard": False}
    shared["memory_limit"] = MEMORY_LIMIT // max(1, len(environments))  # dask's own would be a share by cores
    workers = {
        i: {"cls": Nanny, "options": {**shared, "nthreads": 2 if environment else 1, "env": environment}}
        for i, environment in enumerate(environments)
    }
    here = {"cls": Scheduler, "options": {"host": "127.0.0.1", "port": 0, "dashboard": False}}
    return SpecCluster(workers=workers, scheduler=here, silence_logs="CRITICAL")


def _submit(client, arguments: list[tuple]) -> Iterator[list[ShardReport]]:
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
