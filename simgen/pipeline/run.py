"""Run of a plan: tasks solve and write shards, and workers take one task after the other.

Tasks do not depend on each other, so the dataset does not depend on the number or order of workers.
"""

import time
from collections.abc import Callable, Collection, Iterator, Set
from contextlib import ExitStack, closing, contextmanager
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

from simgen.config.job_schema import Job
from simgen.config.warp_device import check_device
from simgen.dataset.card import write_card
from simgen.dataset.card.readme import arrays_read
from simgen.dataset.growth import grow
from simgen.dataset.reader import Dataset
from simgen.dataset.writer import complete, filling, folder_aside, log_timing, open_or_create
from simgen.errors import NOT_WRITABLE, InputError, cannot_write, writing
from simgen.pipeline.parts import Part, Parts, ShardReport
from simgen.pipeline.plan import Plan
from simgen.pipeline.presser import Presser, fem_presser
from simgen.pipeline.shard import room_for_parts, run_parts, run_shards
from simgen.pipeline.shard_files import Failure
from simgen.pipeline.workers import Workers

# Presses of all tasks that a GPU's process has under way, if tasks have several shards. They are many more than the
# device solves at a time: while some shards wait for their hardest press, others keep the device busy. The host keeps
# samples until their shard has ended, 2.5 MB for a press of the paired job in single precision.
PRESSES_PER_GPU_PROCESS = 4608
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
        several_gpus = plan.device != "cpu" and workers.count > 1 and workers.tasks_at_once > 1
        if several_gpus and len(dataset.sensors) > 1 and not again:
            under_way = workers.count * workers.tasks_at_once * size
            whole, last = shards[:-under_way], shards[-under_way:]
        try:
            solving = _reports(dataset, divide(whole, size), divide(last, size), plan.job, workers, build)
            with closing(solving) as reports:
                for report in reports:
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
    with _folder_of_parts(dataset) as folder, closing(Parts(dataset, folder)) as parts:
        for shards, outcome in _solve(dataset, whole, last, job, workers, build, folder, settled):
            if isinstance(outcome, Failure):
                new = [shard for shard in shards if shard not in settled]
                settled.update(new)
                if outcome.final:
                    yield from _failed(dataset, new, outcome)
                else:
                    again += divide(new, max(1, len(new) // SMALLER))
                continue
            for each in outcome:
                if each.shard in settled:
                    continue
                for report in parts.add(each) if isinstance(each, Part) else [each]:
                    settled.add(report.shard)
                    yield report
        for report in parts.rest():
            settled.add(report.shard)
            yield report
    lost = sorted({shard for shards in (*whole, *last) for shard in shards} - settled)
    yield from _failed(dataset, lost, Failure("no worker solved it", None))
    for task in again:
        for _, outcome in _solve(dataset, [task], [], job, workers, build):
            yield from _failed(dataset, task, outcome) if isinstance(outcome, Failure) else outcome


@contextmanager
def _folder_of_parts(dataset: Dataset) -> Iterator[Path]:
    """A folder for unfinished files of parts, which this process locks. Raises `InputError` if there can be none."""
    with ExitStack() as stack:
        with writing(dataset.path):
            folder = stack.enter_context(folder_aside(dataset))
        yield folder.resolve()  # workers may have another working folder


def _solve(
    dataset: Dataset, whole: list[list[int]], last: list[list[int]], job: Job, workers: Workers,
    build: Callable[[Job, str, str], Presser], folder: Path | None = None, settled: Set[int] = frozenset(),
) -> Iterator[tuple[list[int], list[ShardReport] | list[Part] | Failure]]:  # fmt: skip
    """Yield shards of tasks with their outcomes, as they end. Shared tasks of ``settled`` shards are left out."""
    (reference, *others), given = dataset.sensors, (dataset.path.resolve(), job, workers.device, build)
    tasks = [(run_shards, shards, given, ()) for shards in whole]
    tasks += [(run_parts, shards, given, (reference, folder)) for shards in last]
    shared = (
        (run_parts, shards, given, (sensor, folder))
        for shards in last for sensor in others if not settled.issuperset(shards)
    )  # fmt: skip
    room = partial(room_for_parts, others, max(map(len, last), default=1) * job.dataset.presses_per_shard, folder)
    for task, outcome in workers.map(_guarded, tasks, shared, room):
        yield task[1], Failure.of(outcome) if isinstance(outcome, Exception) else outcome


def _guarded(task: tuple) -> list[ShardReport] | list[Part] | Failure:
    """Solve some shards; an exception becomes a `Failure`."""
    run_task, shards, (path, job, device, build), of_part = task
    try:
        return run_task(path, shards, job, device, build, *of_part)
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
