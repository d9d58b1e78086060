"""Run of a plan: tasks solve and write shards, and workers take one task after the other.

Tasks do not depend on each other, so the dataset does not depend on the number or order of workers.
"""

import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from simgen.config.job_schema import Job
from simgen.config.warp_device import check_device
from simgen.dataset.card import write_card
from simgen.dataset.card.readme import arrays_read
from simgen.dataset.growth import grow
from simgen.dataset.reader import Dataset
from simgen.dataset.writer import complete, filling, folder_aside, log_timing, open_or_create
from simgen.errors import NOT_WRITABLE, InputError, cannot_write
from simgen.pipeline.parts import PartReport, Parts, ShardReport
from simgen.pipeline.plan import Plan
from simgen.pipeline.presser import Presser, fem_presser
from simgen.pipeline.shard import run_parts, run_shards
from simgen.pipeline.shard_files import Failure
from simgen.pipeline.workers import Workers

# Presses of all tasks that a GPU's process has under way, if tasks have several shards. They are many more than the
# device solves at a time: while some shards wait for their hardest press, others keep the device busy. The host keeps
# samples until their shard has ended, 2.5 MB for a press of the paired job in single precision.
PRESSES_PER_GPU_PROCESS = 4608
# Presses on each further sensor that a GPU has at a time if several GPUs share them: more than its pools hold.
PRESSES_SHARED_AT_ONCE = 1152
SMALLER = 8  # parts in which a failed task is tried again; most of them may succeed


def run(
    plan: Plan,
    output: Path,
    workers: Workers | None = None,
    on_start: Callable[[int], Any] = lambda already: None,
    on_report: Callable[[ShardReport], Any] = lambda report: None,
    build: Callable[[Job, str, str], Presser] = fem_presser,
    again: Collection[int] = (),
    close_workers: bool = False,
) -> Dataset:
    """Create or open a dataset, add new trajectories, and solve every unfinished shard.

    workers : made by `start_workers`; None solves in this process
    on_start : called with the number of presses that are finished already
    on_report : called with the report of each shard
    build : makes the function that solves presses
    again : finished shards to solve once more
    close_workers : let the processes of the workers end while the last files are written; no other run can use them

    After an interrupt or a kill, the same call completes the dataset. A shard stays unfinished if its task fails twice,
    by an exception or a dead process, or once by bad input. Its report then carries the error. Raises `InputError` if
    `output` holds another dataset, is locked by another run or cannot be written, and if the scheduler is lost.
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
        whole, last = shards, []
        if workers.share_presses and plan.device != "cpu" and not again:
            at_once = workers.count * workers.tasks_at_once * size
            whole, last = shards[:-at_once], shards[-at_once:]
        try:
            for report in _reports(dataset, divide(whole, size), divide(last, size), plan.job, workers, build):
                log_timing(dataset, {"finished": time.time(), **asdict(report)})
                if not report.error:  # so that the card needs no time at the end
                    dataset.keep(report.shard, arrays_read(dataset))
                on_report(report)
                if report.errno in NOT_WRITABLE:
                    raise InputError(cannot_write(output, report.errno))
        except BaseException:
            workers.close()
            raise
        if close_workers:
            workers.begin_to_close()
        if not dataset.unfinished():
            with folder_aside(dataset) as folder:
                write_card(dataset, folder)
        dataset.drop_kept()
    return dataset


def _reports(
    dataset: Dataset, whole: list[list[int]], last: list[list[int]], job: Job, workers: Workers,
    build: Callable[[Job, str, str], Presser],
) -> Iterator[ShardReport]:  # fmt: skip
    """Yield reports of all shards. The ``last`` are solved sensor by sensor, so that all workers end together.

    What fails is tried once more after the others, in smaller tasks with all sensors. A task that kills its process
    kills the tasks beside it, so these are tried one at a time.
    """
    again, settled = [], set()  # settled: shards that have a report, or are tried again
    with folder_aside(dataset) as folder:
        parts = Parts(dataset, folder)
        for shards, outcome in _solve(dataset, whole, last, job, workers, build):
            if isinstance(outcome, Failure):
                left = [shard for shard in shards if shard not in settled]
                settled.update(left)
                if outcome.final:
                    yield from _failed(dataset, left, outcome)
                else:
                    again += divide(left, max(1, len(left) // SMALLER))
                continue
            for each in outcome:
                report = parts.add(each) if isinstance(each, PartReport) else each
                if report is not None and report.shard not in settled:
                    settled.add(report.shard)
                    yield report
    for task in again:
        for _, outcome in _solve(dataset, [task], [], job, workers, build):
            yield from _failed(dataset, task, outcome) if isinstance(outcome, Failure) else outcome


def _solve(
    dataset: Dataset, whole: list[list[int]], last: list[list[int]], job: Job, workers: Workers,
    build: Callable[[Job, str, str], Presser],
) -> Iterator[tuple[list[int], list[ShardReport] | list[PartReport] | Failure]]:  # fmt: skip
    """Yield shards of tasks with their outcomes, as they end."""
    (reference, *others), given = dataset.sensors, (dataset.path.resolve(), job, workers.device, build)
    tasks = [(run_shards, shards, given, ()) for shards in whole]
    tasks += [(run_parts, shards, given, (reference,)) for shards in last]
    shared = [(run_parts, shards, given, (sensor,)) for sensor in others for shards in last]
    at_once = -(-PRESSES_SHARED_AT_ONCE // (job.dataset.presses_per_shard * max(map(len, last), default=1)))
    for task, outcome in workers.map(_guarded, tasks, shared, at_once):
        yield task[1], Failure.of(outcome) if isinstance(outcome, Exception) else outcome


def _guarded(task: tuple) -> list[ShardReport] | list[PartReport] | Failure:
    """Solve some shards; an exception becomes a `Failure`."""
    run_task, shards, (path, job, device, build), sensors = task
    try:
        return run_task(path, shards, job, device, build, *sensors)
    except Exception as error:
        failure = Failure.of(error)
        if failure.errno is not None and not str(getattr(error, "filename", "")).startswith(str(path)):
            return replace(failure, errno=None, final=False)  # a file outside the dataset
        return failure


def _failed(dataset: Dataset, shards: list[int], failure: Failure) -> list[ShardReport]:
    counts = {shard: len(dataset.shard_presses(shard)) for shard in shards}
    return [ShardReport(shard, counts[shard], error=failure.sentence, errno=failure.errno) for shard in shards]


def divide(shards: list[int], size: int) -> list[list[int]]:
    """Divide shards into parts of at most ``size``."""
    return [shards[first : first + size] for first in range(0, len(shards), size)]


def shards_per_task(shards: int, job: Job, workers: Workers) -> int:
    """Number of shards in a GPU's task: as many as fit, or fewer, so that all processes have equally many tasks."""
    most = max(1, PRESSES_PER_GPU_PROCESS // (workers.tasks_at_once * job.dataset.presses_per_shard))
    rounds = max(1, -(-shards // (most * workers.count)))
    return max(1, -(-shards // (rounds * workers.count)))
